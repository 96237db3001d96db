// Shading of albedo and normals with lightmaps, in WebGL2, in two passes.
//
//     c = D(k_d a s_d(n) + sum_e k_s(e) s_s(e, r)),   r = 2 (n.v) n - v
//
// First the linear light of every pixel, into a float picture; then, as wanted, the pixel filter,
// and D. The numbers are those of totalediting: look-ups as `lightmaps.sample` makes them (bilinear
// between texel centres, columns wrap, beyond a pole lies the pole's row turned by half a circle),
// composed as `phong.compose` and shown as `phong.display`. Lightmaps are in their environment's own
// frame, normals in the camera's; the shader turns directions by Rz(-angle) camera_to_world.

import { surface } from "./surface.js";

export const SHININESS = [1, 16, 32, 64];

const VERTEX = `#version 300 es
void main() {
  vec2 corner = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2);
  gl_Position = vec4(2.0 * corner - 1.0, 0.0, 1.0);
}`;

const LIGHT = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler2DArray;

uniform sampler2D albedo;      // linear; alpha in w
uniform sampler2D normal;      // camera space
uniform sampler2DArray maps;   // diffuse, then specular 1, 16, 32, 64
uniform vec4 lens;             // focal x, y and centre x, y in pixels, y down
uniform mat3 turn;             // camera space to the lightmaps' frame
uniform float exposure;        // linear factor
uniform float diffuse;
uniform vec4 specular;
out vec4 colour;

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
  if (dot(n, n) < 1e-6) {
    colour = vec4(exposure * light(turn * -v, 4), 0.0); // what is behind, as blurred as that lobe
    return;
  }
  vec3 r = 2.0 * dot(n, v) / dot(n, n) * n - v;
  vec3 back = turn * r;
  vec3 shaded = diffuse * texelFetch(albedo, pixel, 0).rgb * light(turn * n, 0);
  for (int i = 0; i < 4; i++) shaded += specular[i] * light(back, i + 1);
  colour = vec4(exposure * shaded, 1.0);
}`;

// Row 0 of all pictures is the upper one; the canvas counts from below.
const SHOW = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;

uniform sampler2D linear;      // light; whether there is a surface in w
uniform sampler2D albedo;      // alpha in w
uniform bool filtered;
uniform bool backdrop;
out vec4 colour;

vec3 display(vec3 x) {
  x = clamp(x, 0.0, 8.0);
  vec3 bent = 0.8 + log(1.0 + 26.23164050992174 * (max(x, 0.8) - 0.8)) / 26.23164050992174;
  bent = mix(bent, x, lessThanEqual(x, vec3(0.8)));
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
  vec3 behind = here.w > 0.0 ? vec3(0.0) : display(here.rgb);
  colour = backdrop && here.w == 0.0 ? vec4(behind, 1.0) : vec4(display(shaded), there);
}`;

/** A failure of WebGL, as one line for people. */
export class ShadingError extends Error {}

export class Shading {
  /** Raises `ShadingError` where WebGL2 with float pictures cannot be had. */
  constructor(canvas) {
    this.canvas = canvas;
    const gl = canvas.getContext("webgl2", {
      alpha: true, premultipliedAlpha: false, antialias: false, depth: false,
      preserveDrawingBuffer: true,
    });
    if (!gl?.getExtension("EXT_color_buffer_float")) {
      throw new ShadingError("This browser offers no WebGL2 with float pictures; light needs them.");
    }
    this.gl = gl;
    this.light = new Program(gl, LIGHT);
    this.show = new Program(gl, SHOW);
    this.textures = Object.fromEntries(
      ["albedo", "normal", "maps", "linear"].map((name) => [name, gl.createTexture()]),
    );
    this.target = gl.createFramebuffer();
    this.ready = { shot: false, maps: false };
  }

  /**
   * What is shaded. Arrays are {data, shape, type} of one height and width.
   *
   * @param albedo (H, W, 3) float32, linear  @param normal (H, W, 3) float32, camera space
   * @param alpha (H, W) uint8, or float32 in [0, 1]
   * @param camera meta.json's: `intrinsics` 3×3 in pixels, `camera_to_world` 4×4
   */
  setShot(albedo, normal, alpha, camera) {
    const { gl, canvas } = this;
    const [height, width] = albedo.shape;
    Object.assign(canvas, { width, height });
    const { base, directions } = surface(albedo, normal, alpha);
    for (const [name, data] of [["albedo", base], ["normal", directions], ["linear", null]]) {
      gl.bindTexture(gl.TEXTURE_2D, this.textures[name]);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, data);
      nearest(gl, gl.TEXTURE_2D);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(
      gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.textures.linear, 0,
    );
    const [[fx, , cx], [, fy, cy]] = camera.intrinsics;
    this.lens = [fx, fy, cx, cy];
    this.axes = camera.camera_to_world;
    this.ready.shot = true;
  }

  /** Lightmaps (5, 3, H, 2H) float32, in their environment's own frame. */
  setLightmaps({ data, shape }) {
    const [layers, , height, width] = shape;
    const plane = height * width;
    const texels = new Float32Array(4 * layers * plane);
    for (let layer = 0; layer < layers; layer++) {
      for (let c = 0; c < 3; c++) {
        const from = (3 * layer + c) * plane;
        for (let i = 0; i < plane; i++) texels[4 * (layer * plane + i) + c] = data[from + i];
      }
    }
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.textures.maps);
    gl.texImage3D(
      gl.TEXTURE_2D_ARRAY, 0, gl.RGBA32F, width, height, layers, 0, gl.RGBA, gl.FLOAT, texels,
    );
    nearest(gl, gl.TEXTURE_2D_ARRAY);
    this.ready.maps = true;
  }

  /**
   * Draws the shot and returns true; false while it or its light is missing.
   *
   * @param settings `angle` of the environment about +Z in radians, `exposure` linear factor,
   *   `diffuse` k_d, `specular` k_s of SHININESS, `filtered` whether pixels take the mean around
   *   them as a camera's do, `backdrop` whether the environment lies behind
   */
  draw(settings) {
    if (!this.ready.shot || !this.ready.maps) return false;
    const { gl, light, show, textures, canvas } = this;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    light.use({ albedo: textures.albedo, normal: textures.normal }, { maps: textures.maps });
    gl.uniform4f(light.places.lens, ...this.lens);
    gl.uniformMatrix3fv(light.places.turn, false, columns(this.axes, settings.angle));
    gl.uniform1f(light.places.exposure, settings.exposure);
    gl.uniform1f(light.places.diffuse, settings.diffuse);
    gl.uniform4f(light.places.specular, ...settings.specular);
    gl.drawArrays(gl.TRIANGLES, 0, 3);

    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    show.use({ linear: textures.linear, albedo: textures.albedo });
    gl.uniform1i(show.places.filtered, Number(settings.filtered));
    gl.uniform1i(show.places.backdrop, Number(settings.backdrop));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    return true;
  }

  /** Linear light at a pixel as it was last drawn, [r, g, b]; null where there is no surface. */
  read(x, y) {
    const { gl } = this;
    if (!this.ready.shot || !this.ready.maps) return null;
    const found = new Float32Array(4);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.readPixels(x, y, 1, 1, gl.RGBA, gl.FLOAT, found);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return found[3] ? [...found.subarray(0, 3)] : null;
  }

  /** Frees the graphics card's memory at once. */
  close() {
    this.gl?.getExtension("WEBGL_lose_context")?.loseContext();
  }
}

/** A fragment shader that covers the picture, with its uniforms' places. */
class Program {
  constructor(gl, fragment) {
    this.gl = gl;
    this.program = link(gl, VERTEX, fragment);
    this.places = {};
    for (let i = gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORMS) - 1; i >= 0; i--) {
      const { name } = gl.getActiveUniform(this.program, i);
      this.places[name] = gl.getUniformLocation(this.program, name);
    }
  }

  /** Takes the program and binds pictures and stacks of pictures by their uniforms' names. */
  use(pictures, stacks = {}) {
    const { gl } = this;
    gl.useProgram(this.program);
    const all = [[gl.TEXTURE_2D, pictures], [gl.TEXTURE_2D_ARRAY, stacks]]
      .flatMap(([target, named]) => Object.entries(named).map((entry) => [target, ...entry]));
    all.forEach(([target, name, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, texture);
      gl.uniform1i(this.places[name], unit);
    });
    gl.activeTexture(gl.TEXTURE0 + all.length);
  }
}

/** Rz(-angle) times the rotation of `axes`, column by column as WebGL takes it. */
function columns(axes, angle) {
  const cosine = Math.cos(angle);
  const sine = Math.sin(angle);
  return [0, 1, 2].flatMap((j) => [
    cosine * axes[0][j] + sine * axes[1][j],
    cosine * axes[1][j] - sine * axes[0][j],
    axes[2][j],
  ]);
}

function nearest(gl, target) {
  gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  gl.texParameteri(target, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
}

/** A program of two shaders; raises `ShadingError` with the driver's first line. */
export function link(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) {
      throw new ShadingError(`shader: ${(gl.getShaderInfoLog(shader) ?? "").split("\n")[0]}`);
    }
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    throw new ShadingError(`shader: ${(gl.getProgramInfoLog(program) ?? "").split("\n")[0]}`);
  }
  return program;
}
