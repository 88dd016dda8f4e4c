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
const USUAL_PICTURE = 50; // two frames and a little, ms
const MESSAGE_TIME = [2, 1000]; // where pictures take longer, messages get so many times as long before the next one, and at most so many ms

function connect(view, offerColours) {
  const seen = { session: null, tiles: 0n, messages: 0, bytes: 0, connections: 0 };
  let pause = RETRY[0], drawing = false, again = false;
  /** A picture of what has come. A machine that draws slowly takes messages meanwhile, so that the last picture comes sooner. */
  const redraw = () => {
    if (drawing) {
      again = true;
      clearTimeout(view.settling);
      return;
    }
    [drawing, again] = [true, false];
    requestAnimationFrame((begin) => {
      view.draw();
      byId("stage").dataset.ready = "yes";
      requestAnimationFrame(() => requestAnimationFrame((end) => setTimeout(() => {
        drawing = false;
        if (again) redraw();
      }, Math.min(MESSAGE_TIME[0] * Math.max(end - begin - USUAL_PICTURE, 0), MESSAGE_TIME[1]))));
    });
  };
  const state = (name, text) => {
    byId("state").dataset.state = name;
    byId("state").textContent = text;
  };
  const readers = {
    0(m) {
      const { session, resumed } = JSON.parse(m.text());
      if (!resumed) {
        view.clear();
        seen.tiles = 0n;
      }
      seen.session = session;
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
      const m = new Message(data), kind = m.u32(), number = m.u64();
      readers[kind]?.(m, number);
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

try {
  const view = new LiveView(byId("canvas"));
  steer(view);
  const offerColours = livePanel(view);
  offerColours();
  view.draw();
  // For tests and for the curious: what is there, in the console.
  window.voxelastic = { view, seen: connect(view, offerColours) };
} catch (error) {
  byId("state").dataset.state = "lost";
  byId("state").textContent = `The map cannot be shown in 3D: ${error.message}. A current Firefox, Chrome or Safari can.`;
}
