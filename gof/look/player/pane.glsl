#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}

//// the fragments
#version 300 es
// What was blended, over a picture of the camera or over black.
precision highp float;
precision highp sampler2D;

uniform sampler2D blended;
uniform sampler2D behind;
uniform float strength; // of the picture behind
uniform vec4 picture;   // where it lies in the pane: left, top, width, height, px from the top left
uniform vec2 origin;    // of the pane in the canvas, px from the bottom left
uniform vec2 size;      // of the pane, px
out vec4 light;

void main() {
  vec4 front = texelFetch(blended, ivec2(gl_FragCoord.xy), 0);
  vec2 pixel = vec2(gl_FragCoord.x - origin.x, size.y - (gl_FragCoord.y - origin.y));
  vec2 at = (pixel - picture.xy) / picture.zw;
  vec3 back = vec3(0.0);
  if (strength > 0.0 && all(greaterThanEqual(at, vec2(0.0))) && all(lessThanEqual(at, vec2(1.0))))
    back = strength * texture(behind, at).rgb;
  light = vec4(front.rgb + (1.0 - front.a) * back, 1.0);
}
