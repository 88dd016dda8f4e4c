// The view of a map in a notebook: an anywidget module. One WebGL canvas, no libraries.

const VERTEX = `#version 300 es
uniform mat4 u_view;
in vec3 a_position, a_normal;
in vec4 a_colour;
out vec3 v_normal;
out vec4 v_colour;
void main() {
  v_normal = a_normal;
  v_colour = a_colour;
  gl_Position = u_view * vec4(a_position, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform int u_mode;
uniform vec3 u_light;
in vec3 v_normal;
in vec4 v_colour;
out vec4 colour;
void main() {
  if (u_mode == 0) {
    float light = 0.45 + 0.55 * max(dot(normalize(v_normal), u_light), 0.0);
    colour = vec4(v_colour.rgb * light, 1.0);
  } else if (u_mode == 1) {
    colour = vec4(0.9, 0.25, 0.15, 1.0);
  } else {
    // The depth in four bytes, the finest last.
    vec4 parts = fract(gl_FragCoord.z * vec4(1.0, 255.0, 65025.0, 16581375.0));
    colour = parts - parts.yzww * vec4(1.0 / 255.0, 1.0 / 255.0, 1.0 / 255.0, 0.0);
  }
}`;

const NEAREST = 0.02;

function program(gl) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  return made;
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((c) => c / Math.hypot(...a));

// Where one looks from: at a point, from a distance, by two angles.
class Camera {
  constructor(low, high) {
    this.target = low.map((c, k) => (c + high[k]) / 2);
    this.size = Math.max(Math.hypot(...low.map((c, k) => high[k] - c)), 0.1);
    this.distance = 1.15 * this.size;
    this.azimuth = -2.2;
    this.elevation = 0.95;
  }

  axes() {
    const [c, s] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    const back = [c * Math.cos(this.azimuth), c * Math.sin(this.azimuth), s];
    const right = [-Math.sin(this.azimuth), Math.cos(this.azimuth), 0];
    return { back, right, up: cross(back, right) };
  }

  eye() {
    return this.target.map((c, k) => c + this.distance * this.axes().back[k]);
  }

  range() {
    return [Math.max(NEAREST, 0.01 * this.distance), this.distance + 2 * this.size];
  }

  // Column by column.
  matrix(aspect) {
    const { back, right, up } = this.axes();
    const [near, far] = this.range();
    const f = 1 / Math.tan(0.4);
    const rows = [right, up, back].map((axis) => [...axis, -dot(axis, this.eye())]);
    const depth = rows[2].map((c) => (c * (far + near)) / (near - far));
    depth[3] += (2 * far * near) / (near - far);
    const full = [rows[0].map((c) => (c * f) / aspect), rows[1].map((c) => c * f), depth, rows[2].map((c) => -c)];
    return new Float32Array([0, 1, 2, 3].flatMap((column) => full.map((row) => row[column])));
  }

  // The point at a place of the canvas, -1 to 1, and a depth, 0 to 1.
  point(x, y, depth, aspect) {
    const { back, right, up } = this.axes();
    const [near, far] = this.range();
    const ahead = (2 * far * near) / (far + near - (2 * depth - 1) * (far - near));
    const side = Math.tan(0.4) * ahead;
    return this.eye().map((c, k) => c + side * (x * aspect * right[k] + y * up[k]) - ahead * back[k]);
  }
}

const bytes = (model, name) => {
  const data = model.get(name);
  return data ? data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength) : new ArrayBuffer(0);
};

function render({ model, el }) {
  const canvas = document.createElement("canvas");
  canvas.style.cssText = "width: 100%; display: block; touch-action: none; cursor: grab; background: #f4f5f7";
  canvas.tabIndex = 0;
  canvas.setAttribute("aria-label", "The map in 3D: drag to turn, with shift to move, wheel to zoom, double-click to pick a point");
  const said = document.createElement("div");
  said.style.cssText = "font: 12px sans-serif; color: #555; padding: 2px 4px";
  el.append(canvas, said);
  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) {
    said.textContent = "This browser has no WebGL 2: the map cannot be shown.";
    return;
  }
  const shaders = program(gl);
  const at = (name) => gl.getUniformLocation(shaders, name);
  const uniforms = { view: at("u_view"), mode: at("u_mode"), light: at("u_light") };
  const buffers = Object.fromEntries(["vertices", "normals", "colours", "triangles", "path"].map((name) => [name, gl.createBuffer()]));
  let camera = null;
  let [corners, steps] = [0, 0];
  let waiting = 0;

  function attribute(name, buffer, size, type) {
    const place = gl.getAttribLocation(shaders, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, type, type === gl.UNSIGNED_BYTE, 0, 0);
  }

  function load() {
    const vertices = new Float32Array(bytes(model, "_vertices"));
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    for (let k = 0; k < vertices.length; k++) {
      low[k % 3] = Math.min(low[k % 3], vertices[k]);
      high[k % 3] = Math.max(high[k % 3], vertices[k]);
    }
    for (const name of ["vertices", "normals", "colours", "path"]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
      gl.bufferData(gl.ARRAY_BUFFER, bytes(model, `_${name}`), gl.STATIC_DRAW);
    }
    const triangles = bytes(model, "_triangles");
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.triangles);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);
    corners = triangles.byteLength / 4;
    steps = bytes(model, "_path").byteLength / 12;
    if (vertices.length && !camera) camera = new Camera(low, high);
    if (camera && vertices.length) camera.size = Math.max(Math.hypot(...low.map((c, k) => high[k] - c)), 0.1);
    told();
    later();
  }

  function told() {
    const picked = model.get("picked");
    const detail = model.get("lod") > 0 ? `, level of detail ${model.get("lod")}` : "";
    const place = picked ? ` · picked ${picked.map((c) => c.toFixed(2)).join(", ")} m` : "";
    said.textContent = `${(corners / 3).toLocaleString("en")} triangles${detail}${place}`;
  }

  function draw(mode) {
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...(mode === 2 ? [1, 1, 1, 1] : [0.957, 0.961, 0.969, 1]));
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!camera || !corners) return;
    gl.useProgram(shaders);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.uniformMatrix4fv(uniforms.view, false, camera.matrix(canvas.width / canvas.height));
    const { back, right, up } = camera.axes();
    gl.uniform3fv(uniforms.light, unit(back.map((c, k) => c + 0.5 * up[k] - 0.3 * right[k])));
    gl.uniform1i(uniforms.mode, mode);
    attribute("a_position", buffers.vertices, 3, gl.FLOAT);
    attribute("a_normal", buffers.normals, 3, gl.FLOAT);
    attribute("a_colour", buffers.colours, 4, gl.UNSIGNED_BYTE);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.triangles);
    gl.drawElements(gl.TRIANGLES, corners, gl.UNSIGNED_INT, 0);
    if (mode === 0 && steps > 1) {
      gl.uniform1i(uniforms.mode, 1);
      attribute("a_position", buffers.path, 3, gl.FLOAT);
      for (const name of ["a_normal", "a_colour"]) gl.disableVertexAttribArray(gl.getAttribLocation(shaders, name));
      gl.drawArrays(gl.LINE_STRIP, 0, steps);
    }
  }

  function now() {
    waiting = 0;
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, model.get("height")].map((c) => Math.max(1, Math.round(c * scale)));
    canvas.style.height = `${model.get("height")}px`;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    draw(0);
  }

  function later() {
    if (!waiting) waiting = requestAnimationFrame(now);
  }

  // What is under a place of the canvas; null beside the map.
  function under(event) {
    const box = canvas.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) / box.width, 1 - (event.clientY - box.top) / box.height];
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, canvas.width, canvas.height);
    const depths = gl.createRenderbuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, depths);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, canvas.width, canvas.height);
    const target = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, depths);
    draw(2);
    const pixel = new Uint8Array(4);
    gl.readPixels(Math.floor(x * canvas.width), Math.floor(y * canvas.height), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(target);
    gl.deleteRenderbuffer(depths);
    gl.deleteTexture(texture);
    later();
    if (pixel.every((c) => c === 255)) return null;
    const depth = pixel[0] / 255 + pixel[1] / 255 ** 2 + pixel[2] / 255 ** 3 + pixel[3] / 255 ** 4;
    return camera.point(2 * x - 1, 2 * y - 1, depth, canvas.width / canvas.height);
  }

  function dragged(event) {
    if (!camera || !event.buttons) return;
    const [x, y] = [event.movementX, event.movementY];
    if (event.shiftKey || event.buttons !== 1) {
      const { right, up } = camera.axes();
      const step = (2 * Math.tan(0.4) * camera.distance) / canvas.clientHeight;
      camera.target = camera.target.map((c, k) => c + step * (y * up[k] - x * right[k]));
    } else {
      camera.azimuth -= 0.006 * x;
      camera.elevation = Math.min(1.57, Math.max(-1.57, camera.elevation + 0.006 * y));
    }
    later();
  }

  function zoomed(event) {
    event.preventDefault();
    if (!camera) return;
    camera.distance = Math.min(10 * camera.size, Math.max(0.1, camera.distance * Math.exp(0.001 * event.deltaY)));
    later();
  }

  function pick(event) {
    const point = camera && under(event);
    if (!point) return;
    const origin = model.get("_origin");
    model.set("picked", point.map((c, k) => c + origin[k]));
    model.save_changes();
    camera.target = point;
    told();
  }

  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", dragged);
  canvas.addEventListener("wheel", zoomed, { passive: false });
  canvas.addEventListener("dblclick", pick);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  const size = new ResizeObserver(later);
  size.observe(canvas);
  // The triangles come last of what belongs together, in the order of the messages and of the names.
  let loading = 0;
  const reload = () => {
    if (!loading) loading = setTimeout(() => { loading = 0; load(); }, 0);
  };
  const arrays = ["_vertices", "_normals", "_colours", "_triangles", "_path"];
  arrays.forEach((name) => model.on(`change:${name}`, reload));
  model.on("change:height", later);
  model.on("change:picked", told);
  load();

  return () => {
    arrays.forEach((name) => model.off(`change:${name}`, reload));
    model.off("change:height", later);
    model.off("change:picked", told);
    size.disconnect();
    cancelAnimationFrame(waiting);
    clearTimeout(loading);
    gl.getExtension("WEBGL_lose_context")?.loseContext();
  };
}

export default { render };
