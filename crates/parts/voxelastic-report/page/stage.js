// A picture of surfaces and lines in 3D, and the camera. What is drawn is up to classes that extend it.

const FOV = 0.75; // vertical opening angle, radians
const BACKDROP = 8e6; // pixels of the pictures that are combined, at most

/**
 * Draws what `surfaces()` gives: each has a `matrix` to the map, a `colour`, perhaps a `mode` of its own, and `parts` as `upload` returns them. `bounds` are the `low` and `high` corner
 * of the map and the `heights` of the colours; `lines` are sets of segments, each shown if `show` says so.
 */
class Stage {
  constructor(canvas) {
    // The drawing is kept, so that the picture can be saved.
    const gl = canvas.getContext("webgl2", { preserveDrawingBuffer: true, antialias: false, alpha: false, powerPreference: "high-performance" });
    if (!gl) throw new Error("this browser has no WebGL 2");
    Object.assign(this, { canvas, gl, listeners: [], lines: {} });
    this.show = { mode: 0, backs: false, low: -Infinity, high: Infinity };
    this.surfaceProgram = program(gl, SURFACE_VERTEX, SURFACE_FRAGMENT);
    this.lineProgram = program(gl, LINE_VERTEX, LINE_FRAGMENT);
    this.screenProgram = program(gl, SCREEN_VERTEX, SCREEN_FRAGMENT);
    this.empty = gl.createVertexArray();
    this.ramps = Object.fromEntries(Object.entries(DATA.ramps).map(([name, stops]) => [name, this.rampTexture(stops)]));
    new ResizeObserver(() => this.camera && this.draw()).observe(canvas);
    canvas.addEventListener("webglcontextlost", (e) => e.preventDefault());
  }

  surfaces() { return []; }

  /** The ramp of the colours that are shown. */
  rampName() { return COLOURS[this.show.mode].ramp; }

  drawPoints() {}

  upload({ vertices, colours, indices }) {
    const { gl } = this;
    const vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    const buffers = [gl.createBuffer(), gl.createBuffer()];
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[0]);
    gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.STATIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[1]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
    const attribute = (place, count, type, normalised, offset) => {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, count, type, normalised, STRIDE, offset);
    };
    // Formats that every graphics card reads as they are. Of three numbers, or of whole ones, drivers make copies as floating-point numbers before the first picture.
    attribute(0, 4, gl.UNSIGNED_SHORT, true, 0);
    attribute(1, 2, gl.UNSIGNED_BYTE, true, 6);
    attribute(2, 4, gl.UNSIGNED_BYTE, true, 8);
    if (colours) {
      buffers.push(gl.createBuffer());
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[2]);
      gl.bufferData(gl.ARRAY_BUFFER, colours, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(3);
      gl.vertexAttribPointer(3, 4, gl.UNSIGNED_BYTE, true, 4, 0);
    }
    return { vao, buffers, count: indices.length };
  }

  rampTexture(stops) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, stops.length, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, new Uint8Array(stops.flat()));
    for (const [key, value] of [["MIN_FILTER", "LINEAR"], ["MAG_FILTER", "LINEAR"], ["WRAP_S", "CLAMP_TO_EDGE"], ["WRAP_T", "CLAMP_TO_EDGE"]])
      gl.texParameteri(gl.TEXTURE_2D, gl["TEXTURE_" + key], gl[value]);
    return texture;
  }

  /** A set of line segments, empty at first. */
  lineSet() {
    const { gl } = this;
    const vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([0, -1, 1, -1, 0, 1, 1, 1]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    for (const [place, count, type, normalised, offset] of
      [[1, 3, gl.FLOAT, false, 0], [2, 3, gl.FLOAT, false, 12], [3, 4, gl.UNSIGNED_BYTE, true, 24]]) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, count, type, normalised, 28, offset);
      gl.vertexAttribDivisor(place, 1);
    }
    return { vao, buffer, count: 0 };
  }

  /** Fills a set with segments [from, to, "#rrggbb", width]. */
  fill(set, segments) {
    const { gl } = this;
    const bytes = new ArrayBuffer(28 * segments.length);
    const numbers = new Float32Array(bytes), tints = new Uint8Array(bytes);
    segments.forEach(([from, to, colour, width], i) => {
      numbers.set(from, i * 7);
      numbers.set(to, i * 7 + 3);
      tints.set([...rgb(colour).map((c) => Math.round(c * 255)), Math.round(width * 16)], i * 28 + 24);
    });
    gl.bindBuffer(gl.ARRAY_BUFFER, set.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, bytes, gl.DYNAMIC_DRAW);
    set.count = segments.length;
  }

  /** The whole map, from the side and above: from whichever side it fills the picture better. */
  reset(now) {
    const views = [-0.42, -1.15].map((yaw) => this.fitted(yaw, 0.62));
    this.fly(views[0].distance <= views[1].distance ? views[0] : views[1], now);
  }

  /** From straight above, map y up. */
  top() {
    this.fly(this.fitted(-Math.PI / 2, 1.5707));
  }

  /** The camera that has the whole map in what the panel leaves of the picture. */
  fitted(yaw, pitch) {
    const { low, high } = this.bounds, { canvas } = this;
    const middle = scaled(add(low, high), 0.5), [across, up] = this.axes({ yaw, pitch });
    const towards = [Math.cos(yaw) * Math.cos(pitch), Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch)];
    const panel = byId("panel"), covered = getComputedStyle(panel).position === "absolute" ? panel.offsetLeft + panel.offsetWidth : 0;
    const tall = Math.tan(FOV / 2) * 0.98, wide = (tall * Math.max(canvas.clientWidth - covered, 50)) / Math.max(canvas.clientHeight, 1);
    const distances = [0, 1, 2, 3, 4, 5, 6, 7].map((corner) => {
      const c = sub([0, 1, 2].map((k) => ((corner >> k) & 1 ? high : low)[k]), middle);
      return dot(c, towards) + Math.max(Math.abs(dot(c, across)) / wide, Math.abs(dot(c, up)) / tall);
    });
    const distance = Math.max(...distances, 0.5);
    const metresPerPixel = (2 * Math.tan(FOV / 2) * distance) / Math.max(canvas.clientHeight, 1);
    return { target: add(middle, scaled(across, (-covered / 2) * metresPerPixel)), distance, yaw, pitch };
  }

  /** Moves the camera there, in half a second or at once. */
  fly(to, now) {
    const from = this.camera;
    const still = now || !from || matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (still) {
      this.camera = { ...to };
      return this.draw();
    }
    to.yaw = from.yaw + ((((to.yaw - from.yaw) % (2 * Math.PI)) + 3 * Math.PI) % (2 * Math.PI)) - Math.PI;
    const start = performance.now();
    const step = (time) => {
      const t = Math.min(Math.max((time - start) / 550, 0), 1), s = t * t * (3 - 2 * t);
      const mix = (a, b) => a * (1 - s) + b * s;
      this.camera = { target: from.target.map((v, i) => mix(v, to.target[i])), distance: Math.exp(mix(Math.log(from.distance), Math.log(to.distance))),
        yaw: mix(from.yaw, to.yaw), pitch: mix(from.pitch, to.pitch) };
      this.draw();
      if (t < 1 && this.flight === step) requestAnimationFrame(step);
    };
    this.flight = step;
    requestAnimationFrame(step);
  }

  eye() {
    const { target, distance, yaw, pitch } = this.camera;
    return add(target, scaled([Math.cos(yaw) * Math.cos(pitch), Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch)], distance));
  }

  /** Directions of the picture in the map: across and up. */
  axes({ yaw, pitch } = this.camera) {
    return [[-Math.sin(yaw), Math.cos(yaw), 0], [-Math.cos(yaw) * Math.sin(pitch), -Math.sin(yaw) * Math.sin(pitch), Math.cos(pitch)]];
  }

  /** Metres that a pixel of the page is wide at the target. */
  metresPerPixel() {
    return (2 * Math.tan(FOV / 2) * this.camera.distance) / Math.max(this.canvas.clientHeight, 1);
  }

  /** Draws soon: quickly now, and finely when nothing moves any more. */
  draw() {
    if (!this.waiting) this.waiting = requestAnimationFrame(() => { this.waiting = 0; this.render(false); });
    clearTimeout(this.settling);
    this.settling = setTimeout(() => this.render(true), 160);
  }

  pictures(width, height) {
    const { gl } = this;
    if (this.target && this.target.width === width && this.target.height === height) return this.target;
    if (this.target) [this.target.colours, this.target.distances].forEach((t) => gl.deleteTexture(t)), gl.deleteRenderbuffer(this.target.depth);
    const texture = () => {
      const t = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, t);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, width, height);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      return t;
    };
    const target = { width, height, colours: texture(), distances: texture(), depth: gl.createRenderbuffer(), frame: this.target?.frame || gl.createFramebuffer() };
    gl.bindRenderbuffer(gl.RENDERBUFFER, target.depth);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target.colours, 0);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT1, gl.TEXTURE_2D, target.distances, 0);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, target.depth);
    return (this.target = target);
  }

  render(fine, sharpness = 1) {
    const { gl, canvas } = this;
    const ratio = Math.min(devicePixelRatio || 1, 2) * sharpness;
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const samples = fine && width * height * 4 <= BACKDROP ? 2 : 1;
    const target = this.pictures(width * samples, height * samples);
    this.place(width / height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
    gl.viewport(0, 0, target.width, target.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    this.drawSurfaces();
    this.drawPoints(samples * ratio);
    this.drawLines(target, samples * ratio);
    gl.disable(gl.DEPTH_TEST);
    this.combine(target, width, height, samples, ratio);
    this.listeners.forEach((listen) => listen());
  }

  /** The matrix to the screen, and how far the picture reaches. */
  place(aspect) {
    const { low, high } = this.bounds;
    const size = Math.hypot(...sub(high, low));
    const { distance, target, pitch } = this.camera;
    const centre = scaled(add(low, high), 0.5), eye = this.eye();
    this.farthest = Math.hypot(...sub(eye, centre)) + size;
    const near = Math.max(Math.min(distance * 0.02, 2), this.farthest * 1e-4);
    const up = pitch > 1.5 ? this.axes()[1] : [0, 0, 1];
    this.toScreen = product(perspective(FOV, aspect, near, this.farthest), lookAt(eye, target, up));
  }

  drawSurfaces() {
    const { gl, show } = this;
    const { p, uniforms: u } = this.surfaceProgram;
    gl.useProgram(p);
    gl.uniformMatrix4fv(u.toScreen, false, this.toScreen);
    gl.uniform3fv(u.eye, this.eye());
    gl.uniform3fv(u.unknown, rgb(themed("--soft")));
    gl.uniform2fv(u.heights, this.bounds.heights);
    gl.uniform2f(u.slice, Math.max(show.low, -1e9), Math.min(show.high, 1e9));
    gl.uniform1f(u.farthest, this.farthest);
    gl.uniform1i(u.backs, show.backs ? 1 : 0);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.ramps[this.rampName()] || this.ramps.height);
    gl.uniform1i(u.ramp, 0);
    gl.vertexAttrib3f(3, 0.5, 0.5, 0.5); // of surfaces without colours among others that have some
    for (const s of this.surfaces()) {
      gl.uniformMatrix4fv(u.toMap, false, s.matrix);
      gl.uniform1i(u.mode, s.mode ?? show.mode);
      gl.uniform3fv(u.submapColour, s.colour.map((c) => c / 255));
      for (const { vao, count, first } of s.parts) {
        gl.bindVertexArray(vao);
        gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_SHORT, 2 * (first || 0));
      }
    }
  }

  drawLines(target, pixels) {
    const { gl, show } = this;
    const { p, uniforms: u } = this.lineProgram;
    gl.useProgram(p);
    gl.uniformMatrix4fv(u.toScreen, false, this.toScreen);
    gl.uniform2f(u.screen, target.width, target.height);
    gl.uniform1f(u.widen, pixels / 16);
    gl.uniform1f(u.farthest, this.farthest);
    gl.uniform2f(u.slice, Math.max(show.low, -1e9), Math.min(show.high, 1e9));
    const sets = Object.entries(this.lines).filter(([name, set]) => show[name] && set.count).map(([, set]) => set);
    const all = (strength) => {
      gl.uniform1f(u.strength, strength);
      for (const { vao, count } of sets) {
        gl.bindVertexArray(vao);
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
      }
    };
    all(1);
    // What is hidden behind surfaces shines through.
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.NONE]);
    gl.depthMask(false);
    gl.depthFunc(gl.GREATER);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    all(0.3);
    gl.disable(gl.BLEND);
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
  }

  combine(target, width, height, samples, ratio) {
    const { gl } = this;
    const { p, uniforms: u } = this.screenProgram;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.useProgram(p);
    [target.colours, target.distances].forEach((texture, i) => {
      gl.activeTexture(gl.TEXTURE0 + i);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    });
    gl.uniform1i(u.colours, 0);
    gl.uniform1i(u.distances, 1);
    gl.uniform2f(u.size, target.width, target.height);
    gl.uniform1i(u.samples, samples);
    gl.uniform1f(u.radius, 1.4 * ratio * samples);
    gl.uniform1f(u.strength, 0.9);
    gl.uniform3fv(u.top, rgb(themed("--stage-top")));
    gl.uniform3fv(u.bottom, rgb(themed("--stage-bottom")));
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** The point of the map at a place of the canvas (page pixels from its corner); null where there is none. */
  pick(x, y) {
    const { gl, canvas, target } = this;
    if (!target) return null;
    const byte = new Uint8Array(4);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
    gl.readBuffer(gl.COLOR_ATTACHMENT1);
    const u = x / canvas.clientWidth, v = 1 - y / canvas.clientHeight;
    gl.readPixels(Math.floor(u * target.width), Math.floor(v * target.height), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, byte);
    gl.readBuffer(gl.COLOR_ATTACHMENT0);
    if (byte[3] < 128) return null;
    const away = ((byte[0] + byte[1] / 255 + byte[2] / 65025) / 255) * this.farthest;
    const [across, up] = this.axes();
    const tall = Math.tan(FOV / 2), aspect = canvas.clientWidth / canvas.clientHeight;
    const ahead = unit(sub(this.camera.target, this.eye()));
    return add(this.eye(), add(scaled(ahead, away), add(scaled(across, (2 * u - 1) * tall * aspect * away), scaled(up, (2 * v - 1) * tall * away))));
  }

  /** Where a point of the map is on the canvas, page pixels; null behind the viewer. */
  project(point) {
    const m = this.toScreen;
    const row = (r) => m[r] * point[0] + m[4 + r] * point[1] + m[8 + r] * point[2] + m[12 + r];
    const w = row(3);
    return w <= 0 ? null : [(row(0) / w * 0.5 + 0.5) * this.canvas.clientWidth, (0.5 - row(1) / w * 0.5) * this.canvas.clientHeight];
  }
}
