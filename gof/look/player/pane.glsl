#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}

//// the fragments
#version 300 es
// Blended Gaussians over a picture of the camera or over black; emissive ones as gof/core/colour.py add_light has it.
precision highp float;
precision highp sampler2D;

uniform sampler2D blended;
uniform sampler2D behind;
uniform float strength; // of the picture behind
uniform bool emissive;  // light that is added
uniform float shine;    // of the Gaussians
uniform vec4 picture;   // where it lies in the pane: left, top, width, height, px from the top left
uniform vec2 origin;    // of the pane in the canvas, px from the bottom left
uniform vec2 size;      // of the pane, px
out vec4 light;

vec3 toLight(vec3 display) {
  return mix(display / 12.92, pow((max(display, 0.04045) + 0.055) / 1.055, vec3(2.4)), greaterThan(display, vec3(0.04045)));
}

vec3 toDisplay(vec3 linear) {
  return mix(12.92 * linear, 1.055 * pow(max(linear, 0.0031308), vec3(1.0 / 2.4)) - 0.055, greaterThan(linear, vec3(0.0031308)));
}

void main() {
  vec4 front = texelFetch(blended, ivec2(gl_FragCoord.xy), 0);
  front.rgb *= shine;
  vec2 pixel = vec2(gl_FragCoord.x - origin.x, size.y - (gl_FragCoord.y - origin.y));
  vec2 at = (pixel - picture.xy) / picture.zw;
  vec3 back = vec3(0.0);
  if (strength > 0.0 && all(greaterThanEqual(at, vec2(0.0))) && all(lessThanEqual(at, vec2(1.0))))
    back = strength * texture(behind, at).rgb;
  vec3 shown = front.rgb + (1.0 - front.a) * back;
  if (emissive) {
    float cover = max(front.a - max(max(front.r, front.g), front.b), 0.0);
    shown = toDisplay((1.0 - cover) * toLight(back) + toLight(front.rgb));
  }
  light = vec4(shown, 1.0);
}
