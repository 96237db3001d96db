// The shaders of light: albedo and normals shaded with lightmaps, in two passes.
//
//     c = D(k_d a s_d(n) + sum_e k_s(e) s_s(e, r)),   r = 2 (n.v) n - v
//
// The first pass writes the linear light of every pixel into a float texture; the second applies
// the pixel filter, if wanted, and D. Results equal those of totalediting: look-ups as in
// `lightmaps.sample` (bilinear between texel centres; columns wrap; beyond a pole lies the pole's
// row turned by half a circle), composed as in `phong.compose`, displayed as by `phong.display`.
// Lightmaps are in their environment's own frame, normals in the camera's; directions are rotated
// by Rz(-angle) camera_to_world.

export const VERTEX = `#version 300 es
void main() {
  vec2 corner = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2);
  gl_Position = vec4(2.0 * corner - 1.0, 0.0, 1.0);
}`;

export const LIGHT = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler2DArray;

uniform sampler2D albedo;      // linear; w: alpha
uniform sampler2D normal;      // camera space
uniform sampler2DArray maps;   // diffuse, then specular 1, 16, 32, 64
uniform vec4 lens;             // focal x, y and centre x, y in pixels, y down
uniform mat3 turn;             // camera space to the lightmaps' frame
uniform float exposure;        // linear factor
uniform float diffuse;
uniform vec4 specular;
layout(location = 0) out vec4 colour;   // w: whether there is a surface
layout(location = 1) out vec4 behind;

const float PI = 3.14159265358979;

vec3 texel(int column, int row, int layer) {
  ivec2 size = textureSize(maps, 0).xy;
  if (row < 0) { row = -1 - row; column += size.x / 2; }
  if (row >= size.y) { row = 2 * size.y - 1 - row; column += size.x / 2; }
  column = ((column % size.x) + size.x) % size.x;
  return texelFetch(maps, ivec3(column, row, layer), 0).rgb;
}

vec3 light(vec3 d, int layer) {
  vec2 size = vec2(textureSize(maps, 0).xy);
  float ring = length(d.xy);
  float azimuth = ring == 0.0 ? 0.0 : atan(d.y, d.x);
  float polar = ring == 0.0 && d.z == 0.0 ? 0.0 : atan(ring, d.z);
  vec2 place = vec2(0.5 - azimuth / (2.0 * PI), polar / PI) * size - 0.5;
  vec2 low = floor(place);
  vec2 part = place - low;
  ivec2 at = ivec2(low);
  vec3 upper = mix(texel(at.x, at.y, layer), texel(at.x + 1, at.y, layer), part.x);
  vec3 lower = mix(texel(at.x, at.y + 1, layer), texel(at.x + 1, at.y + 1, layer), part.x);
  return mix(upper, lower, part.y);
}

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec2 centre = gl_FragCoord.xy;
  vec3 v = normalize(vec3(-(centre.x - lens.z) / lens.x, (centre.y - lens.w) / lens.y, 1.0));
  vec3 n = texelFetch(normal, pixel, 0).xyz;
  behind = vec4(exposure * light(turn * -v, 4), 1.0); // the environment, blurred by that lobe
  colour = vec4(0.0);
  if (dot(n, n) < 1e-6) return;
  vec3 r = 2.0 * dot(n, v) / dot(n, n) * n - v;
  vec3 back = turn * r;
  vec3 shaded = diffuse * texelFetch(albedo, pixel, 0).rgb * light(turn * n, 0);
  for (int i = 0; i < 4; i++) shaded += specular[i] * light(back, i + 1);
  colour = vec4(exposure * shaded, 1.0);
}`;

// Row 0 of every texture is the top one; the canvas counts from the bottom.
export const SHOW = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;

uniform sampler2D linear;      // light; w: whether there is a surface
uniform sampler2D far;         // light of the background
uniform sampler2D albedo;      // w: alpha
uniform int format;           // of the dataset: pictures of the first had another curve
uniform bool filtered;
uniform bool backdrop;
out vec4 colour;

vec3 shoulder(vec3 x) {  // of format 1
  x = clamp(x, 0.0, 8.0);
  vec3 bent = 0.8 + log(1.0 + 26.23164050992174 * (max(x, 0.8) - 0.8)) / 26.23164050992174;
  return mix(bent, x, lessThanEqual(x, vec3(0.8)));
}

float largest(vec3 x) { return max(x.r, max(x.g, x.b)); }

vec3 response(vec3 x) {
  x = max(x, 0.0);
  x /= max(largest(x) / 16.0, 1.0);
  float brightest = max(largest(x), 1e-6);
  float ratio = pow((brightest + 0.002) / 0.2835, 1.25);
  float tone = (pow(ratio / (1.0 + ratio), 1.6) - 4.9606047125324184e-05) / 0.9896948862654779;
  float colour = 1.0 - 0.6 * pow(tone, 6.0);
  return tone * (1.0 - colour) + colour * (tone / brightest) * x;
}

vec3 display(vec3 x) {
  vec3 bent = format == 1 ? shoulder(x) : response(x);
  vec3 power = 1.055 * pow(max(bent, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
  return min(mix(power, 12.92 * bent, lessThanEqual(bent, vec3(0.0031308))), 1.0);
}

void main() {
  ivec2 size = textureSize(linear, 0);
  ivec2 pixel = ivec2(int(gl_FragCoord.x), size.y - 1 - int(gl_FragCoord.y));
  vec4 here = texelFetch(linear, pixel, 0);
  vec4 sum = vec4(0.0);
  for (int y = -1; y <= 1; y++) for (int x = -1; x <= 1; x++) {
    ivec2 at = pixel + ivec2(x, y);
    if (any(lessThan(at, ivec2(0))) || any(greaterThanEqual(at, size))) continue;
    vec4 light = texelFetch(linear, at, 0);
    float weight = float((2 - abs(x)) * (2 - abs(y))) * light.w;
    sum += vec4(light.rgb * weight, weight);
  }
  vec3 shaded = filtered && sum.w > 0.0 ? sum.rgb / sum.w : here.rgb;
  float there = here.w * texelFetch(albedo, pixel, 0).a;
  vec3 behind = display(texelFetch(far, pixel, 0).rgb);
  colour = backdrop ? vec4(mix(behind, display(shaded), there), 1.0) : vec4(display(shaded), there);
}`;
