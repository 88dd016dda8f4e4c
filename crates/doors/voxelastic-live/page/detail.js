// How much of a tile is drawn: all of its triangles, or fewer where they would be smaller than pixels; nothing of what is out of the picture.

/** Cells along the longest edge of a tile in its coarser levels, the finest first; each half as many as the one before. */
const CELLS = [16, 8, 4];
/** Smallest and largest edge of a cell in pictures that are made quickly, pixels. */
const CELL_PIXELS = [1, 8];
/** The same in fine pictures: of machines that draw in time, and of others. */
const FINE_PIXELS = [1, 2];
/** What a quick picture may take, ms: one that took longer is followed by coarser ones. */
const PICTURE_TIME = 60;

/** Calls `done` when the graphics card, or what stands in for it, has done all that it was given. */
function whenFinished(gl, done) {
  const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
  gl.flush();
  const look = () => {
    if (!gl.isContextLost() && gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) return setTimeout(look, 3);
    gl.deleteSync(fence);
    done();
  };
  setTimeout(look, 0);
}

/** The largest coordinates of the vertices of a chunk, steps. */
function highest({ vertices }) {
  const words = new Uint16Array(vertices.buffer);
  let x = 0, y = 0, z = 0;
  for (let at = 0; at < words.length; at += STRIDE / 2) {
    if (words[at] > x) x = words[at];
    if (words[at + 1] > y) y = words[at + 1];
    if (words[at + 2] > z) z = words[at + 2];
  }
  return [x, y, z];
}

/** For each vertex of a chunk its cell of the finest level, four bits for each axis, and how far it is from the borders of the tile that it is near to, steps. */
function cellsOf({ vertices }, [x, y, z]) {
  const words = new Uint16Array(vertices.buffer), count = words.length / (STRIDE / 2), longest = Math.max(x, y, z, 1), near = longest / CELLS.at(-1);
  const cells = new Uint16Array(count), away = new Uint32Array(count), scale = (CELLS[0] - 1e-6) / longest;
  const from = (c, most) => {
    const least = Math.min(c, most - c);
    return least < near ? least : 0;
  };
  for (let i = 0, at = 0; i < count; i++, at += STRIDE / 2) {
    const a = words[at], b = words[at + 1], c = words[at + 2];
    cells[i] = ((a * scale) | 0) | (((b * scale) | 0) << 4) | (((c * scale) | 0) << 8);
    away[i] = from(a, x) + from(b, y) + from(c, z);
  }
  return { cells, away };
}

/**
 * Fewer triangles over the same vertices: those whose corners lie in three cells, each corner moved to one vertex of its cell (Rossignac and Borrel 1993), the one
 * that is nearest to the borders of the tile, so that tiles leave no gaps between them. The cells have 2 ** `shift` of those of the finest level along each edge.
 */
function coarser(indices, { cells, away }, shift) {
  const bits = 4 - shift, mask = (1 << bits) - 1, chosen = new Int32Array(1 << (3 * bits)).fill(-1), cell = new Uint16Array(cells.length);
  for (let i = 0; i < cells.length; i++) {
    const c = cells[i];
    const number = ((c >> shift) & mask) | (((c >> (4 + shift)) & mask) << bits) | (((c >> (8 + shift)) & mask) << (2 * bits));
    cell[i] = number;
    if (chosen[number] < 0 || away[i] < away[chosen[number]]) chosen[number] = i;
  }
  const kept = new Uint16Array(indices.length);
  let length = 0;
  for (let i = 0; i < indices.length; i += 3) {
    const a = cell[indices[i]], b = cell[indices[i + 1]], c = cell[indices[i + 2]];
    if (a === b || b === c || c === a) continue;
    kept[length] = chosen[a];
    kept[length + 1] = chosen[b];
    kept[length + 2] = chosen[c];
    length += 3;
  }
  return kept.subarray(0, length);
}

/** A chunk with the triangles of all levels one after the other, and where those of each begin and how many corners they have. `most` as [`highest`] of the tile. */
function levelled(chunk, most) {
  const found = cellsOf(chunk, most), all = [chunk.indices, ...CELLS.map((_, shift) => coarser(chunk.indices, found, shift))];
  const indices = new Uint16Array(all.reduce((sum, some) => sum + some.length, 0)), levels = [];
  let first = 0;
  for (const some of all) {
    indices.set(some, first);
    levels.push({ first, count: some.length });
    first += some.length;
  }
  return { ...chunk, indices, levels };
}

/** The level whose cells are no longer than `allowed` metres in a tile of `longest` metres. */
function levelFor(longest, allowed) {
  let level = 0;
  while (level < CELLS.length && longest / CELLS[level] <= allowed) level++;
  return level;
}

/** Whether a ball around a point of the map may be in the picture. */
function isInPicture(m, [x, y, z], radius) {
  const row = (r) => m[r] * x + m[4 + r] * y + m[8 + r] * z + m[12 + r];
  const w = row(3), length = (r, sign) => Math.hypot(m[3] + sign * m[r], m[7] + sign * m[4 + r], m[11] + sign * m[8 + r]);
  for (let r = 0; r < 2; r++) {
    const c = row(r);
    if (w + c < -radius * length(r, 1) || w - c < -radius * length(r, -1)) return false;
  }
  return w > -radius * Math.hypot(m[3], m[7], m[11]);
}
