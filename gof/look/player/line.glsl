#version 300 es
// The way of the gas at a Gaussian in a short time, as a line that ends where it is now.
precision highp float;
precision highp sampler2D;

const float NEAR = 0.01;
const int TEXELS = 7;

uniform highp usampler2D order; // rows of the cloud, farthest first; four vertices each
uniform sampler2D cloud;
uniform int perLine;
uniform sampler2D scheme;
uniform float largest, time;
uniform float span;       // s of the way
uniform float share;      // of the Gaussians that have a line
uniform bool truth;       // the true velocity instead of the Gaussian's own
uniform float thick;      // px
uniform vec3 eye;
uniform mat3 axes;
uniform vec2 focal, centre, size;
uniform float skew;

out vec4 paint;

int row;

vec4 texel(int k) {
  int i = row;
  return texelFetch(cloud, ivec2((i % perLine) * TEXELS + k, i / perLine), 0);
}

void main() {
  int place = gl_VertexID >> 2, width = textureSize(order, 0).x;
  row = int(texelFetch(order, ivec2(place % width, place / width), 0).r);
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  if (fract(float(row % 65536) * 0.61803399) >= share) return; // the same ones at all times
  vec4 a = texel(0), b = texel(1);
  float late = time - a.w;
  float z = late * b.w;
  vec3 v = texel(truth ? 6 : 5).xyz;
  if (dot(v, v) == 0.0) return;
  vec3 head = (a.xyz + late * b.xyz - eye) * axes;
  vec3 tail = head - (v * span) * axes;
  if (min(head.z, tail.z) <= NEAR) return;
  vec2 h = focal * head.xy / head.z + vec2(skew * head.y / head.z, 0.0) + centre;
  vec2 t = focal * tail.xy / tail.z + vec2(skew * tail.y / tail.z, 0.0) + centre;
  vec2 way = h - t;
  vec2 across = length(way) > 1e-3 ? normalize(vec2(-way.y, way.x)) : vec2(1, 0);
  float end = float((gl_VertexID >> 1) & 1);
  vec2 at = (mix(t, h, end) + (float(gl_VertexID & 1) - 0.5) * thick * across * mix(0.4, 1.0, end)) / size;
  gl_Position = vec4(2.0 * at.x - 1.0, 1.0 - 2.0 * at.y, 0.0, 1.0);
  float value = clamp(length(v) / largest, 0.0, 1.0);
  float alpha = mix(0.05, 0.9, end) * exp(-0.5 * z * z);
  paint = vec4(texture(scheme, vec2(value * 255.0 / 256.0 + 0.5 / 256.0, 0.5)).rgb * alpha, alpha);
}

//// the fragments
#version 300 es
precision highp float;

in vec4 paint;
out vec4 light;

void main() {
  light = paint;
}
