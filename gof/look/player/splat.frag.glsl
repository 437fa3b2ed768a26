#version 300 es
precision highp float;

in vec2 offset;
flat in vec3 conic;
flat in vec4 paint;
out vec4 light;

void main() {
  float q = conic.x * offset.x * offset.x + 2.0 * conic.y * offset.x * offset.y + conic.z * offset.y * offset.y;
  float alpha = paint.a * exp(-0.5 * q);
  if (alpha < 1.0 / 255.0) discard;
  alpha = min(alpha, 0.99);
  light = vec4(paint.rgb * alpha, alpha); // premultiplied; colours may be negative or above 1
}
