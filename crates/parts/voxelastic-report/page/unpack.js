// The packed surfaces; the layout is described where it is written (pack.rs).

/** Bytes per vertex in a chunk's buffer: three u16, normal (2), intensity, scale, error, one to spare. */
const STRIDE = 12;

/** The blob of the page, decompressed. */
async function blobBytes() {
  const text = byId("blob").textContent.trim();
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Every surface's chunks as {vertices: Uint8Array, colours: Uint8Array or null, indices: Uint16Array}. */
function unpacked(bytes) {
  const take = reader(bytes);
  return DATA.surfaces.map((surface) => unpackedChunks(take, surface.chunks, surface.has_colours));
}

/** A function that gives the next `n` bytes. */
function reader(bytes) {
  let at = 0;
  return (n) => bytes.subarray(at, (at += n));
}

/** The chunks of one surface, of `v` vertices and `t` triangles each. */
function unpackedChunks(take, chunks, hasColours) {
  return chunks.map(({ v, t }) => {
    const vertices = new Uint8Array(v * STRIDE);
    const words = new Uint16Array(vertices.buffer);
    for (let k = 0; k < 3; k++) {
      const low = take(v), high = take(v);
      for (let i = 0, here = 0; i < v; i++) {
        const z = low[i] | (high[i] << 8);
        here = (here + ((z >> 1) ^ -(z & 1))) & 0xffff;
        words[(i * STRIDE) / 2 + k] = here;
      }
    }
    for (let k = 6; k < 11; k++) {
      const column = take(v);
      for (let i = 0; i < v; i++) vertices[i * STRIDE + k] = column[i];
    }
    const colours = hasColours ? new Uint8Array(4 * v) : null;
    for (let k = 0; colours && k < 3; k++) {
      const column = take(v);
      for (let i = 0; i < v; i++) colours[4 * i + k] = column[i];
    }
    const indices = new Uint16Array(3 * t);
    const low = take(3 * t), high = take(3 * t);
    for (let i = 0, newest = 0; i < 3 * t; i++) {
      const corner = newest - (low[i] | (high[i] << 8));
      if (corner === newest) newest++;
      indices[i] = corner;
    }
    return { vertices, colours, indices };
  });
}

/** Unit normal of two bytes. */
function normalOf(u, v) {
  const x = u / 127.5 - 1, y = v / 127.5 - 1, z = 1 - Math.abs(x) - Math.abs(y), t = Math.max(-z, 0);
  return unit([x + (x >= 0 ? -t : t), y + (y >= 0 ? -t : t), z]);
}
