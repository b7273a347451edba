"use strict";
// Draws the picture with WebGL 2: chooses level and tiles, and hands light, view and place to the shader.

const SHOW = { lit: 0, parameter: 1, uncertainty: 2, photograph: 3 }; // as in shaders/web/page.glsl
const HEAD = "#version 300 es\nprecision highp float;\nprecision highp int;\n";

relight.Stage = class {
  constructor(canvas, result, changed) {
    const gl = canvas.getContext("webgl2", { antialias: false, depth: false });
    if (!gl) throw new Error("This browser has no WebGL 2, which draws the material. A current browser has it.");
    this.canvas = canvas;
    this.gl = gl;
    this.result = result;
    this.program = this.linked(result.shader);
    gl.useProgram(this.program);
    gl.bindVertexArray(gl.createVertexArray());
    this.places = new Map();
    this.set("uniform3fv", "u_ramp", result.ramp.flat());
    this.set("uniform3fv", "u_place", result.place.flat());
    this.set("uniform4fv", "u_view", result.view);
    const planes = { maps: result.planes, sigma: result.uncertaintyPlanes };
    this.tiles = new relight.Tiles(gl, (name) => planes[name.split("-")[3]] ?? 1, changed);
  }

  linked({ vertex, fragment }) {
    const gl = this.gl, program = gl.createProgram();
    for (const [type, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, HEAD + text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) {
        throw new Error(`The model's shader does not compile in WebGL 2:\n${gl.getShaderInfoLog(shader)}`);
      }
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    return program;
  }

  set(kind, name, ...values) {
    if (!this.places.has(name)) this.places.set(name, this.gl.getUniformLocation(this.program, name));
    this.gl[kind](this.places.get(name), ...values);
  }

  // Draws a state; returns whether all that it shows has arrived.
  draw(state, area) {
    const { gl, canvas } = this;
    this.ratio = Math.min(window.devicePixelRatio || 1, 2);
    canvas.width = Math.round(canvas.clientWidth * this.ratio);
    canvas.height = Math.round(canvas.clientHeight * this.ratio);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const step = 1 / (state.zoom * this.ratio); // texels a pixel
    this.corner = [state.x - area.x / state.zoom, state.y - area.y / state.zoom];
    this.set("uniform2f", "u_canvas", canvas.height, step);
    this.set("uniform2f", "u_corner", ...this.corner);
    this.step = step;
    const border = state.comparing ? Math.round(state.split * canvas.width) : 0;
    const parts = [this.part(state, border, canvas.width)];
    if (border) parts.unshift({ kind: `p${state.photograph}`, show: SHOW.photograph, from: 0, to: border });
    gl.enable(gl.SCISSOR_TEST);
    const names = [];
    const whole = parts.map((part) => this.drawPart(part, state, names)).every(Boolean);
    this.tiles.want(names);
    return whole;
  }

  part(state, from, to) {
    const shown = this.result.parameters[state.map - 1];
    if (shown && !state.uncertain && shown.place) return { kind: "maps", show: SHOW.parameter, place: shown.place, from, to };
    if (!shown && !state.uncertain) return { kind: "maps", show: SHOW.lit, from, to };
    return { kind: "sigma", show: SHOW.uncertainty, place: this.channels(shown), from, to };
  }

  // First channel and number of channels of an uncertainty: of one map, or the largest of all.
  channels(shown) {
    if (shown) return [shown.uncertainty[0], 1];
    return [0, this.result.parameters.filter((p) => p.place && p.uncertainty).length];
  }

  // Draws the tiles in sight, under those that are absent, or cannot be read, a coarser one.
  drawPart(part, state, names) {
    const { gl, result } = this, [, inside] = result.tile;
    gl.scissor(part.from, 0, part.to - part.from, this.canvas.height);
    this.light(part, state);
    if (part.place) this.set("uniform2iv", "u_parameter", part.place);
    this.set("uniform1i", "u_show", part.show);
    const last = result.levels.length - 1;
    const level = Math.min(last, Math.max(0, Math.round(Math.log2(this.step))));
    const wanted = this.inSight(part, level);
    const under = new Set();
    names.push(`${last}-0-0-${part.kind}`);
    for (const [column, row] of wanted) {
      names.push(`${level}-${column}-${row}-${part.kind}`);
      if (this.tiles.held.get(names.at(-1))?.texture) continue;
      for (let up = 1; level + up <= last; up++) {
        const above = [level + up, column >> up, row >> up].join("-");
        if (!this.tiles.held.get(`${above}-${part.kind}`)?.texture) continue;
        under.add(above);
        break;
      }
    }
    [...under].sort().reverse().forEach((name) => this.drawTile(...name.split("-").map(Number), part, inside));
    return wanted.map(([column, row]) => this.drawTile(level, column, row, part, inside)).every(Boolean);
  }

  inSight(part, level) {
    const [, inside] = this.result.tile, [width, height] = this.result.size, side = inside * 2 ** level;
    const x0 = Math.max(0, this.corner[0] + part.from * this.step), x1 = Math.min(width, this.corner[0] + part.to * this.step);
    const y0 = Math.max(0, this.corner[1]), y1 = Math.min(height, this.corner[1] + this.canvas.height * this.step);
    const found = [];
    for (let row = Math.floor(y0 / side); row * side < y1; row++) {
      for (let column = Math.floor(x0 / side); column * side < x1; column++) found.push([column, row]);
    }
    return found;
  }

  light(part, state) {
    const taken = state.comparing ? this.result.photographs[state.photograph] : null;
    const { u, v } = state.lamp, bright = 2 ** state.exposure;
    this.set("uniform4fv", "u_light", taken ? taken.light : [u, v, Math.sqrt(Math.max(0, 1 - u * u - v * v)), 0]);
    this.set("uniform3fv", "u_intensity", taken ? taken.intensity : [1, 1, 1]);
    // A photograph's codes are those of its white already.
    this.set("uniform1f", "u_exposure", taken && part.show !== SHOW.photograph ? bright / taken.white : bright);
  }

  drawTile(level, column, row, part, inside) {
    const { gl, canvas } = this, scale = 2 ** level, [width, height] = this.result.size;
    const texture = this.tiles.texture(`${level}-${column}-${row}-${part.kind}`);
    if (!texture) return false;
    const x0 = column * inside, y0 = row * inside;
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    this.set("uniform3f", "u_tile", x0 - 1, y0 - 1, scale);
    const x = (texel) => (2 * (texel - this.corner[0])) / this.step / canvas.width - 1;
    const y = (texel) => 1 - (2 * (texel - this.corner[1])) / this.step / canvas.height;
    const right = Math.min((x0 + inside) * scale, width), lower = Math.min((y0 + inside) * scale, height);
    this.set("uniform4f", "u_quad", x(x0 * scale), y(lower), x(right), y(y0 * scale));
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    return true;
  }
};
