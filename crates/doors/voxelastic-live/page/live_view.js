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
    // The first pictures are coarse on any machine: what comes first is to be seen at once.
    this.coarseness = CELL_PIXELS[1];
    // Until then there are no pictures, unless somebody steers.
    this.quietUntil = 0;
    // Once somebody steers, the camera goes nowhere by itself.
    for (const kind of ["pointerdown", "wheel", "keydown"]) canvas.addEventListener(kind, () => { this.steered = true; });
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

  /** The tiles in the picture, each with the triangles of the level that is fine enough where it is. */
  *surfaces() {
    const eye = this.eye(), perMetre = (2 * Math.tan(FOV / 2)) / Math.max(this.canvas.clientHeight, 1);
    this.drawn = { tiles: 0, triangles: 0 };
    for (const tile of this.tiles.values()) {
      if (!isInPicture(this.toScreen, tile.centre, tile.radius)) continue;
      const away = Math.max(Math.hypot(...sub(tile.centre, eye)) - tile.radius, 0);
      const level = levelFor(tile.longest, away * perMetre * this.cellPixels);
      const parts = tile.parts.map(({ vao, levels }) => ({ vao, ...levels[level] })).filter((part) => part.count);
      this.drawn.tiles++;
      this.drawn.triangles += parts.reduce((sum, part) => sum + part.count / 3, 0);
      yield { submap: tile.submap, matrix: tile.matrix, colour: tile.colour, parts };
    }
  }

  /** The surface in a tile, in the frame of the submap that it moves with. */
  setTile(key, { submap, flags, origin, step, chunks }) {
    const old = this.tiles.get(key);
    if (old) this.free(old);
    this.tiles.delete(key);
    if (!chunks.length) return;
    const most = chunks.map(highest).reduce((a, b) => a.map((c, k) => Math.max(c, b[k])));
    const longest = Math.max(...most, 1), size = most.map((c) => c * step);
    const parts = chunks.map((chunk) => {
      const { levels, ...whole } = levelled(chunk, most);
      return { ...this.upload(whole), levels };
    });
    const tile = { submap, origin, step, size, longest: longest * step, radius: Math.hypot(...size) / 2, colour: submapColour(submap), parts };
    tile.triangles = parts.reduce((sum, { levels }) => sum + levels[0].count / 3, 0);
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
    tile.centre = moved(pose || [0, 0, 0, 0, 0, 0, 1], add(tile.origin, scaled(tile.size, 0.5)));
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

  /** The whole map, where there is no robot to look at. */
  fit() {
    if (this.steered || this.scan || !this.submaps.size) return;
    this.refresh();
    this.reset(true);
  }

  /**
   * A picture: a fine one with all that its pixels can show, a quick one with what this machine draws in time. None is begun before the last one is finished:
   * where pictures take long, they would only queue.
   */
  render(fine) {
    const quiet = this.steered ? 0 : this.quietUntil - performance.now();
    if (quiet > 0) setTimeout(() => this.draw(), quiet);
    else if (this.unfinished) this.missed = true;
    if (quiet > 0 || this.unfinished) return;
    this.refresh();
    this.cellPixels = fine ? FINE_PIXELS[this.isSlow ? 1 : 0] : this.coarseness;
    const begin = performance.now();
    // Four times as many pixels are for machines that have drawn the last quick picture in time, a quarter of them for those that cannot.
    super.render(fine && this.coarseness <= 2 * CELL_PIXELS[0], !fine && this.isSlow ? 0.5 : 1);
    this.unfinished = true;
    whenFinished(this.gl, () => {
      const took = performance.now() - begin, [least, most] = CELL_PIXELS;
      this.unfinished = false;
      // The number of triangles goes with the square of their edges.
      if (!fine) this.isSlow = this.coarseness === most && took > PICTURE_TIME;
      if (!fine) this.coarseness = Math.min(Math.max(this.coarseness * Math.sqrt(took / PICTURE_TIME), least), most);
      this.finished?.(took);
      if (this.missed) this.draw();
      this.missed = false;
    });
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
