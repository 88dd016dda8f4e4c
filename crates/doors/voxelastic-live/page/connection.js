// The socket: what it sends goes into the view; when it is lost, it is opened again, and what is there already is not sent again.

/** Reads little-endian numbers of a message. */
class Message {
  constructor(buffer) {
    this.data = new DataView(buffer);
    this.at = 0;
  }
  u32() { return this.data.getUint32((this.at += 4) - 4, true); }
  i32() { return this.data.getInt32((this.at += 4) - 4, true); }
  u64() { return this.data.getBigUint64((this.at += 8) - 8, true); }
  f32() { return this.data.getFloat32((this.at += 4) - 4, true); }
  f64() { return this.data.getFloat64((this.at += 8) - 8, true); }
  many(count, read) { return Array.from({ length: count }, () => this[read]()); }
  place() { return { submap: this.u32(), position: this.many(3, "f32") }; }
  rest() { return new Uint8Array(this.data.buffer, this.at); }
  text() { return new TextDecoder().decode(this.rest()); }
}

const RETRY = [300, 5000]; // first and longest pause before the socket is opened again, ms
const USUAL_PICTURE = 20; // a frame and a little, ms
const LOADING_PAUSE = 2000; // before each picture while the map comes that was there before the page, ms: a processor that draws does not unpack
const MESSAGE_TIME = [2, 1000]; // where pictures take longer, messages get so many times as long before the next one, and at most so many ms

function connect(view, offerColours) {
  // `goal` is the last tile that was there when the page was attached, `busy` the time that messages took, ms.
  const seen = { session: null, tiles: 0n, goal: 0n, messages: 0, bytes: 0, connections: 0, busy: 0 };
  let pause = RETRY[0], drawing = false, again = false, whole = false, notBefore = 0, later = 0;
  /**
   * A picture of what has come. Until all has come that was there before, there are few: pictures of parts would only delay the whole. A machine that draws
   * slowly takes messages between two pictures, so that the last one comes sooner.
   */
  const redraw = () => {
    const isThere = seen.tiles >= seen.goal;
    if (isThere) view.quietUntil = 0;
    // The first picture of all that was there waits for nothing but the one before.
    const wait = Math.max(view.quietUntil, isThere && !whole ? 0 : notBefore) - performance.now();
    if (drawing || wait > 0) {
      again = true;
      clearTimeout(view.settling);
      if (!drawing && !later) later = setTimeout(() => { later = 0; redraw(); }, wait);
      return;
    }
    [drawing, again] = [true, false];
    if (!whole) {
      view.fit();
      whole = seen.tiles > 0n && isThere;
    }
    view.draw();
  };
  view.finished = (took) => {
    byId("stage").dataset.ready = "yes";
    const now = performance.now();
    if (seen.tiles < seen.goal) view.quietUntil = now + LOADING_PAUSE;
    notBefore = now + Math.min(MESSAGE_TIME[0] * Math.max(took - USUAL_PICTURE, 0), MESSAGE_TIME[1]);
    drawing = false;
    if (again) redraw();
  };
  const state = (name, text) => {
    byId("state").dataset.state = name;
    byId("state").textContent = text;
  };
  const readers = {
    0(m) {
      const { session, resumed, tiles } = JSON.parse(m.text());
      if (!resumed) {
        view.clear();
        seen.tiles = 0n;
      }
      [seen.session, seen.goal] = [session, BigInt(tiles)];
      if (seen.tiles < seen.goal) view.quietUntil = performance.now() + LOADING_PAUSE;
    },
    1(m, number) {
      const submap = m.u32(), tile = m.many(3, "i32");
      m.u32(); // scans
      const flags = m.u32(), origin = m.many(3, "f32"), step = m.f32();
      const sizes = Array.from({ length: m.u32() }, () => ({ v: m.u32(), t: m.u32() }));
      const chunks = unpackedChunks(reader(m.rest()), sizes, flags & 1);
      const before = view.flags;
      view.setTile(tile.join(" "), { submap, flags, origin, step, chunks });
      if (view.flags !== before) offerColours();
      seen.tiles = number;
    },
    2(m) { view.setSubmaps(new Map(Array.from({ length: m.u32() }, () => [m.u32(), m.many(7, "f64")]))); },
    3(m) {
      const part = m.u32();
      view.setPath(part, Array.from({ length: m.u32() }, () => m.place()));
    },
    4(m) { view.setLoops(Array.from({ length: m.u32() }, () => [m.place(), m.place()])); },
    5(m) {
      const scans = m.u32(), time = m.f64(), submap = m.u32(), pose = m.many(7, "f32"), count = m.u32();
      view.setScan({ scans, time, submap, pose, points: new Float32Array(m.data.buffer.slice(m.at, m.at + 12 * count)) });
    },
    6(m) { showFigures(JSON.parse(m.text())); },
  };
  const open = () => {
    const socket = new WebSocket(`ws://${location.host}/socket?session=${seen.session || 0}&tiles=${seen.tiles}`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      pause = RETRY[0];
      seen.connections++;
      state("connected", "connected");
    };
    socket.onmessage = ({ data }) => {
      const begin = performance.now(), m = new Message(data), kind = m.u32(), number = m.u64();
      readers[kind]?.(m, number);
      seen.busy += performance.now() - begin;
      seen.messages++;
      seen.bytes += data.byteLength;
      redraw();
    };
    socket.onclose = () => {
      state("lost", "connection lost: trying again");
      setTimeout(open, pause);
      pause = Math.min(pause * 1.6, RETRY[1]);
    };
  };
  open();
  return seen;
}
