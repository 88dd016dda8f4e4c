// The map as it is now: tiles of its one surface, each of which moves with a submap until it is made again, the trajectory, loops, the robot and its last scan.

/** What surfaces can be coloured by; the order is that of `mode` in the shader. */
const COLOURS = [
  { name: "Height", ramp: "height" },
  { name: "Submap", ramp: null },
  { name: "Intensity", ramp: "intensity", flag: 2 },
  { name: "Scale", ramp: "scale" },
  null, // distances from the truth, which a robot does not know
  { name: "As seen", ramp: null, flag: 1 },
];

const POINT_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 at;
uniform mat4 toMap, toScreen;
uniform float size;
out float away;
void main() {
  gl_Position = toScreen * (toMap * vec4(at, 1.0));
  gl_Position.z -= 0.0006 * gl_Position.w;
  gl_PointSize = size;
  away = gl_Position.w;
}`;
const POINT_FRAGMENT = `#version 300 es
precision highp float;
in float away;
uniform float farthest;
uniform vec3 tint;
layout(location = 0) out vec4 colour;
layout(location = 1) out vec4 distance;
${PACK}
void main() {
  colour = vec4(tint, 1.0);
  distance = packed(away / farthest);
}`;

/** A colour of its own for each submap. */
function submapColour(id) {
  const hue = (id * 0.61803398875) % 1, channel = (n) => {
    const k = (n + hue * 12) % 12;
    return Math.round(255 * (0.62 - 0.34 * Math.max(-1, Math.min(k - 3, 9 - k, 1))));
  };
  return [channel(0), channel(8), channel(4)];
}

class LiveView extends Stage {
  constructor(canvas) {
    super(canvas);
    Object.assign(this.show, { path: true, loops: true, scan: true, robot: true });
    this.lines = { path: this.lineSet(), loops: this.lineSet(), robot: this.lineSet() };
    this.pointProgram = program(this.gl, POINT_VERTEX, POINT_FRAGMENT);
    this.points = { vao: this.gl.createVertexArray(), buffer: this.gl.createBuffer(), count: 0 };
    this.gl.bindVertexArray(this.points.vao);
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.points.buffer);
    this.gl.enableVertexAttribArray(0);
    this.gl.vertexAttribPointer(0, 3, this.gl.FLOAT, false, 0, 0);
    this.follow = true;
    this.clear();
    this.camera = { target: [0, 0, 0], distance: 30, yaw: -0.9, pitch: 0.7 };
  }

  /** Nothing is known. */
  clear() {
    for (const tile of this.tiles?.values() || []) this.free(tile);
    Object.assign(this, { tiles: new Map(), submaps: new Map(), parts: new Map(), loopPlaces: [], scan: null, flags: 0, triangles: 0 });
    this.bounds = { low: [-10, -10, -2], high: [10, 10, 6], heights: [-1, 4] };
    this.points.count = 0;
    Object.values(this.lines).forEach((set) => this.fill(set, []));
  }

  free(tile) {
    const { gl } = this;
    this.triangles -= tile.triangles;
    for (const { vao, buffers } of tile.parts) {
      gl.deleteVertexArray(vao);
      buffers.forEach((b) => gl.deleteBuffer(b));
    }
  }

  surfaces() { return this.tiles.values(); }

  /** The surface in a tile, in the frame of the submap that it moves with. */
  setTile(key, { submap, flags, origin, step, chunks }) {
    const old = this.tiles.get(key);
    if (old) this.free(old);
    this.tiles.delete(key);
    if (!chunks.length) return;
    const words = chunks.map((c) => new Uint16Array(c.vertices.buffer));
    const highest = [0, 1, 2].map((k) => words.reduce((most, w) => { for (let i = k; i < w.length; i += STRIDE / 2) if (w[i] > most) most = w[i]; return most; }, 0));
    const tile = { submap, origin, step, size: highest.map((c) => c * step), colour: submapColour(submap), parts: chunks.map((c) => this.upload(c)) };
    tile.triangles = tile.parts.reduce((sum, p) => sum + p.count / 3, 0);
    this.triangles += tile.triangles;
    this.flags |= flags;
    this.tiles.set(key, tile);
    this.placeTile(tile);
    this.stale = true;
  }

  /** Poses of all submaps; what belongs to others is gone. */
  setSubmaps(poses) {
    this.submaps = poses;
    for (const [key, tile] of this.tiles) {
      if (poses.has(tile.submap)) this.placeTile(tile);
      else {
        this.free(tile);
        this.tiles.delete(key);
      }
    }
    this.stale = true;
  }

  placeTile(tile) {
    const pose = this.submaps.get(tile.submap);
    tile.matrix = poseMatrix(pose || [0, 0, 0, 0, 0, 0, 1], tile.origin, tile.step);
  }

  /** Places of submaps' frames in the map; those of unknown submaps are left out. */
  placed(places) {
    return places.filter((p) => this.submaps.has(p.submap)).map((p) => moved(this.submaps.get(p.submap), p.position));
  }

  setPath(part, places) {
    this.parts.set(part, places);
    this.stale = true;
  }

  setLoops(pairs) {
    this.loopPlaces = pairs;
    this.stale = true;
  }

  setScan(scan) {
    const { gl } = this;
    this.scan = scan;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.points.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, scan.points, gl.DYNAMIC_DRAW);
    this.points.count = scan.points.length / 3;
    this.stale = true;
  }

  /** Where the robot is: position and turn in the map. */
  robotPose() {
    const { scan } = this, pose = scan && this.submaps.get(scan.submap);
    if (!pose) return null;
    const [a, b] = [pose.slice(3), scan.pose.slice(3)];
    const v = add(add(scaled(b.slice(0, 3), a[3]), scaled(a.slice(0, 3), b[3])), cross(a.slice(0, 3), b.slice(0, 3)));
    return [...moved(pose, scan.pose.slice(0, 3)), ...v, a[3] * b[3] - dot(a.slice(0, 3), b.slice(0, 3))];
  }

  /** Lines and bounds follow what changed; before each picture. */
  refresh() {
    if (!this.stale) return;
    this.stale = false;
    const path = [...this.parts.keys()].sort((a, b) => a - b).flatMap((part) => this.placed(this.parts.get(part)));
    const [warm, violet, accent] = [themed("--warm"), themed("--violet"), themed("--accent")];
    this.fill(this.lines.path, path.slice(1).map((p, i) => [path[i], p, warm, 2.6]));
    this.fill(this.lines.loops, this.loopPlaces.map((pair) => this.placed(pair)).filter((p) => p.length === 2).map(([a, b]) => [a, b, violet, 3]));
    const robot = this.robotPose();
    const axis = (direction, colour) => [robot.slice(0, 3), moved(robot, direction), colour, 5];
    this.fill(this.lines.robot, robot ? [axis([1.6, 0, 0], "#d8262c"), axis([0, 1.6, 0], "#2aa745"), axis([0, 0, 1.6], "#2f6fe0"),
      [robot.slice(0, 3), add(robot.slice(0, 3), [0, 0, -1.2]), accent, 3]] : []);
    if (robot && this.follow) {
      const far = Math.hypot(...sub(robot.slice(0, 3), this.camera.target));
      this.camera.target = far > 40 ? robot.slice(0, 3) : this.camera.target.map((c, k) => c + (robot[k] - c) * 0.35);
    }
    const ends = [[], [], []];
    const into = (p) => p.forEach((c, k) => ends[k].push(c));
    path.forEach(into);
    for (const { submap, origin, size } of this.tiles.values()) {
      const pose = this.submaps.get(submap);
      if (pose) [origin, add(origin, size)].forEach((corner) => into(moved(pose, corner)));
    }
    if (ends[0].length < 2) return;
    const low = ends.map((e) => quantile(e, 0.01)), high = ends.map((e) => quantile(e, 0.99));
    const ground = quantile(ends[2], 0.05), roof = Math.max(quantile(ends[2], 0.95), ground + 0.5);
    this.bounds = { low, high, heights: [ground, roof] };
  }

  render(fine) {
    this.refresh();
    super.render(fine);
  }

  drawPoints(pixels) {
    const { gl, points, scan } = this, robot = this.robotPose();
    if (!this.show.scan || !points.count || !scan || !robot) return;
    const { p, uniforms: u } = this.pointProgram;
    gl.useProgram(p);
    gl.uniformMatrix4fv(u.toScreen, false, this.toScreen);
    gl.uniformMatrix4fv(u.toMap, false, poseMatrix(robot, [0, 0, 0], 1));
    gl.uniform1f(u.size, 2.2 * pixels);
    gl.uniform1f(u.farthest, this.farthest);
    gl.uniform3fv(u.tint, rgb(themed("--warm")));
    gl.bindVertexArray(points.vao);
    gl.drawArrays(gl.POINTS, 0, points.count);
  }
}
