#version 300 es
// One Gaussian at a time: where it has moved to, how much of its opacity is left, and its ellipse on the screen.
// The projection is that of gof/render/project.py.
precision highp float;
precision highp sampler2D;

const float LEAST_ALPHA = 1.0 / 255.0;
const float DILATION = 0.3; // px²
const float NEAR = 0.01;    // m
const int TEXELS = 7;

uniform highp usampler2D order; // rows of the cloud, farthest first; four vertices each
uniform sampler2D cloud;  // texels of a Gaussian: x0 t_mu | v 1/t_sigma | cov | cov opacity v_sd | rgb | v_gas | v_true
uniform int perLine;      // Gaussians in a line of the texture
uniform sampler2D scheme; // colours of numbers
uniform int colouring;    // 0 the Gaussians' own, 1 speed, 2 uncertainty, 3 true speed, 4 true error
uniform float largest;    // m/s of the scheme's last colour
uniform float time;       // s
uniform float grow;       // factor of all sizes
uniform vec3 eye;         // m
uniform mat3 axes;        // columns: right, down, forward
uniform vec2 focal, centre, size; // px
uniform float skew;

out vec2 offset;          // px from the mean
flat out vec3 conic;
flat out vec4 paint;      // display colour, opacity now

int row;

vec4 texel(int k) {
  int i = row;
  return texelFetch(cloud, ivec2((i % perLine) * TEXELS + k, i / perLine), 0);
}

vec3 mapped(float value) {
  if (value < 0.0) return vec3(0.32); // not known
  return texture(scheme, vec2(clamp(value / largest, 0.0, 1.0) * 255.0 / 256.0 + 0.5 / 256.0, 0.5)).rgb;
}

void main() {
  int place = gl_VertexID >> 2, width = textureSize(order, 0).x;
  row = int(texelFetch(order, ivec2(place % width, place / width), 0).r);
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0); // out of sight
  vec4 a = texel(0), b = texel(1), c = texel(2), d = texel(3), e = texel(4);
  float late = time - a.w;
  float z = late * b.w;
  float opacity = d.z * exp(-0.5 * z * z);
  vec3 p = (a.xyz + late * b.xyz - eye) * axes;
  if (opacity < LEAST_ALPHA || p.z <= NEAR) return;

  vec2 slope = p.xy / p.z;
  vec2 mean = focal * slope + vec2(skew * slope.y, 0.0) + centre;
  slope = clamp(slope, (-0.15 * size - centre) / focal, (1.15 * size - centre) / focal);
  vec3 alongY = axes[1] - slope.y * axes[2];
  vec3 rowX = (focal.x * (axes[0] - slope.x * axes[2]) + skew * alongY) * grow / p.z;
  vec3 rowY = focal.y * alongY * grow / p.z;
  mat3 cov = mat3(c.x, c.y, c.z, c.y, c.w, d.x, c.z, d.x, d.y);
  float xx = dot(rowX, cov * rowX) + DILATION, yy = dot(rowY, cov * rowY) + DILATION, xy = dot(rowX, cov * rowY);
  float det = max(xx * yy - xy * xy, 1e-12);
  conic = vec3(yy, -xy, xx) / det;

  // The quad just holds what is above the least alpha.
  float middle = 0.5 * (xx + yy), apart = length(vec2(0.5 * (xx - yy), xy));
  float longest = middle + apart;
  vec2 along = apart > 1e-6 * middle ? normalize(xx > yy ? vec2(longest - yy, xy) : vec2(xy, longest - xx)) : vec2(1, 0);
  float radius = sqrt(2.0 * log(opacity / LEAST_ALPHA));
  vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0;
  offset = radius * (corner.x * sqrt(longest) * along
                     + corner.y * sqrt(max(middle - apart, DILATION)) * vec2(-along.y, along.x));
  vec2 at = (mean + offset) / size;
  gl_Position = vec4(2.0 * at.x - 1.0, 1.0 - 2.0 * at.y, 0.0, 1.0);

  vec3 shown = e.rgb;
  if (colouring == 1) shown = mapped(length(texel(5).xyz));
  if (colouring == 2) shown = mapped(d.w);
  if (colouring == 3) shown = mapped(length(texel(6).xyz));
  if (colouring == 4) shown = mapped(length(texel(6).xyz - texel(5).xyz) * inversesqrt(3.0)); // of a component, as v_sd is
  paint = vec4(shown, opacity);
}

//// the fragments
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
