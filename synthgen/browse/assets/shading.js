// Shades albedo and normals with lightmaps in WebGL2, in two passes: see shaders.js.

import { LIGHT, SHOW, VERTEX } from "./shaders.js";
import { surface } from "./surface.js";

export const SHININESS = [1, 16, 32, 64];

/** A failure of WebGL, as one line for the user. */
export class ShadingError extends Error {}

export class Shading {
  /** Throws `ShadingError` where WebGL2 with float textures is not available. */
  constructor(canvas) {
    this.canvas = canvas;
    const gl = canvas.getContext("webgl2", {
      alpha: true,
      premultipliedAlpha: false,
      antialias: false,
      depth: false,
      preserveDrawingBuffer: true,
    });
    if (!gl?.getExtension("EXT_color_buffer_float")) {
      throw new ShadingError(
        "Live light needs WebGL2 with float textures, which this browser does not offer.",
      );
    }
    this.gl = gl;
    this.light = new Program(gl, LIGHT);
    this.show = new Program(gl, SHOW);
    this.textures = Object.fromEntries(
      ["albedo", "normal", "maps", "linear", "far"].map((name) => [name, gl.createTexture()]),
    );
    this.target = gl.createFramebuffer();
    this.ready = { shot: false, maps: false };
  }

  /**
   * Sets the shot to shade. Arrays are {data, shape, type} of the same height and width.
   *
   * @param albedo (H, W, 3) float32, linear  @param normal (H, W, 3) float32, camera space
   * @param alpha (H, W) uint8, or float32 in [0, 1]
   * @param camera meta.json's: `intrinsics` 3×3 in pixels, `camera_to_world` 4×4
   * @param format of the dataset
   */
  setShot(albedo, normal, alpha, camera, format) {
    const { gl, canvas } = this;
    const [height, width] = albedo.shape;
    Object.assign(canvas, { width, height });
    const { base, directions } = surface(albedo, normal, alpha);
    const contents = { albedo: base, normal: directions, linear: null, far: null };
    for (const [name, data] of Object.entries(contents)) {
      gl.bindTexture(gl.TEXTURE_2D, this.textures[name]);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, data);
      nearest(gl, gl.TEXTURE_2D);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    const drawn = [gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1];
    gl.framebufferTexture2D(gl.FRAMEBUFFER, drawn[0], gl.TEXTURE_2D, this.textures.linear, 0);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, drawn[1], gl.TEXTURE_2D, this.textures.far, 0);
    gl.drawBuffers(drawn);
    const [[fx, , cx], [, fy, cy]] = camera.intrinsics;
    this.lens = [fx, fy, cx, cy];
    this.axes = camera.camera_to_world;
    this.format = format;
    this.ready.shot = true;
  }

  /** Sets the lightmaps, (5, 3, H, 2H) float32, in their environment's own frame. */
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
      gl.TEXTURE_2D_ARRAY,
      0,
      gl.RGBA32F,
      width,
      height,
      layers,
      0,
      gl.RGBA,
      gl.FLOAT,
      texels,
    );
    nearest(gl, gl.TEXTURE_2D_ARRAY);
    this.ready.maps = true;
  }

  /**
   * Draws the shot and returns true; returns false while it or its light is missing.
   *
   * @param settings `angle` of the environment about +Z in radians, `exposure` linear factor,
   *   `diffuse` k_d, `specular` k_s of SHININESS, `filtered` whether pixels are averaged
   *   with their neighbours as in a camera, `backdrop` whether the environment is shown behind
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
    show.use({ linear: textures.linear, far: textures.far, albedo: textures.albedo });
    gl.uniform1i(show.places.format, this.format);
    gl.uniform1i(show.places.filtered, Number(settings.filtered));
    gl.uniform1i(show.places.backdrop, Number(settings.backdrop));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    return true;
  }

  /** Linear light at a pixel as last drawn, [r, g, b]; null where there is no surface. */
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

  /** Uses the program and binds textures and texture arrays by the names of their uniforms. */
  use(pictures, stacks = {}) {
    const { gl } = this;
    gl.useProgram(this.program);
    const all = [
      [gl.TEXTURE_2D, pictures],
      [gl.TEXTURE_2D_ARRAY, stacks],
    ].flatMap(([target, named]) => Object.entries(named).map((entry) => [target, ...entry]));
    all.forEach(([target, name, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, texture);
      gl.uniform1i(this.places[name], unit);
    });
    gl.activeTexture(gl.TEXTURE0 + all.length);
  }
}

/** Rz(-angle) times the rotation of `axes`, in WebGL's column-major order. */
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

/** A program of two shaders; throws `ShadingError` with the driver's first line. */
export function link(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of [
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ]) {
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
