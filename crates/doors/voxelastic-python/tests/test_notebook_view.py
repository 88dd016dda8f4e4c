"""The view of a map in a notebook, in a real browser: what the widget sends is drawn, turned, zoomed and picked."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOM
from headless import seen

import voxelastic as vx

pytest.importorskip("anywidget")
from voxelastic.notebook import MapView

# The other side of the widget's module: what anywidget hands to it, with the state that the kernel would send.
PAGE = """<!doctype html><meta charset="utf-8"><body style="width: 800px"><div id="cell"></div><script type="module">
const complaints = [];
addEventListener("error", (event) => complaints.push(event.message));
addEventListener("unhandledrejection", (event) => complaints.push(String(event.reason)));
console.error = (...words) => complaints.push(words.join(" "));
const state = await (await fetch("state.json")).json();
const arrays = async (names, folder) => {
  for (const name of names) state[name] = new DataView(await (await fetch(`${folder}${name}.bin`)).arrayBuffer());
};
const names = ["_vertices", "_normals", "_colours", "_triangles", "_path"];
await arrays(names, "first");
const listeners = {};
const sent = [];
const tell = (name) => (listeners[`change:${name}`] || []).forEach((f) => f());
const model = {
  get: (name) => state[name],
  set: (name, value) => { state[name] = value; tell(name); },
  save_changes: () => sent.push(state.picked),
  on: (name, f) => (listeners[name] ||= []).push(f),
  off: (name, f) => (listeners[name] = (listeners[name] || []).filter((g) => g !== f)),
};
const { default: widget } = await import("./widget.js");
const el = document.getElementById("cell");
const drop = await widget.render({ model, el });
const frames = async () => { for (let k = 0; k < 4; k++) await new Promise((next) => requestAnimationFrame(next)); await new Promise((next) => setTimeout(next, 30)); };
const canvas = el.querySelector("canvas");
const picture = () => {
  const gl = canvas.getContext("webgl2");
  const pixels = new Uint8Array(4 * canvas.width * canvas.height);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return new Uint32Array(pixels.buffer);
};
const different = (a, b) => { let n = 0; for (let k = 0; k < a.length; k++) n += a[k] !== b[k]; return n / a.length; };
const box = () => canvas.getBoundingClientRect();
const fire = (kind, Type, options) => canvas.dispatchEvent(new Type(kind, { bubbles: true, cancelable: true, clientX: box().left + 400, clientY: box().top + 240, ...options }));
await frames();
const seen = { size: [canvas.width, canvas.height] };
let before = picture();
seen.colours = new Set(before).size;
seen.drawn = before.filter((c) => c !== before[0]).length / before.length;
const acts = { turn: ["pointermove", PointerEvent, { buttons: 1, movementX: 60, movementY: 20 }], move: ["pointermove", PointerEvent, { buttons: 1, shiftKey: true, movementX: 80, movementY: 0 }],
  zoom: ["wheel", WheelEvent, { deltaY: -300 }] };
// Where something is drawn: rows of pixels are counted from below.
const places = [...before.keys()].filter((k) => before[k] !== before[0]);
const place = places[places.length >> 1];
fire("dblclick", MouseEvent, { clientX: box().left + (place % canvas.width) + 0.5, clientY: box().top + canvas.height - Math.floor(place / canvas.width) - 0.5 });
await frames();
seen.picked = state.picked;
seen.sent = sent;
seen.text = el.innerText;
before = picture();
seen.acts = {};
for (const [name, [kind, Type, options]] of Object.entries(acts)) {
  fire(kind, Type, options);
  await frames();
  const after = picture();
  seen.acts[name] = different(before, after);
  before = after;
}
before = picture();
await arrays(names, "second");
names.forEach(tell);
await frames();
seen.shown_anew = different(before, picture());
state.height = 300;
tell("height");
await frames();
seen.height = canvas.height;
drop();
seen.left = Object.values(listeners).flat().length;
seen.complaints = complaints;
await fetch("seen", { method: "POST", body: JSON.stringify(seen) });
</script>"""

ARRAYS = ("_vertices", "_normals", "_colours", "_triangles", "_path")


def files(view: MapView, folder: str) -> dict[str, bytes]:
    return {f"{folder}{name}.bin": getattr(view, name) for name in ARRAYS}


def test_a_map_is_drawn_turned_and_picked(room: vx.Map, tmp_path: Path) -> None:
    view = MapView(room)
    assert view.lod == 0 and view.picked is None
    mesh = room.mesh()
    assert np.array_equal(np.frombuffer(view._vertices, "<f4").reshape(-1, 3), mesh.vertices)
    state = {"height": view.height, "picked": None, "lod": view.lod, "_origin": view._origin}
    served = {"page.html": PAGE.encode(), "widget.js": str(MapView._esm).encode()}
    served |= {"state.json": json.dumps(state).encode()} | files(view, "first")
    # Half of the room: the view goes on where one looked from.
    half = mesh.triangles[(mesh.vertices[mesh.triangles][:, :, 0] < 0).all(axis=1)]
    view.show(vx.Mesh(mesh.vertices, half, mesh.normals, mesh.scales, mesh.intensity, mesh.colours))
    served |= files(view, "second")
    said: Any = seen(served, tmp_path / "profile")
    assert said["complaints"] == [], said
    assert said["size"] == [800, 480] and said["height"] == 300
    assert said["colours"] > 100 and 0.2 < said["drawn"] < 1, said
    assert all(share > 0.02 for share in said["acts"].values()) and len(said["acts"]) == 3, said
    assert said["shown_anew"] > 0.02 and said["left"] == 0, said
    # What was double-clicked is on the surface that the picture shows.
    assert said["sent"] == [said["picked"]]
    assert mesh.distance([said["picked"]])[0] < 0.02 and "picked" in said["text"] and "triangles" in said["text"], said
    assert (np.abs(said["picked"]) < ROOM + 0.05).all()


def test_a_large_map_is_shown_coarser(room: vx.Map) -> None:
    view = MapView(room, most_triangles=len(room.mesh()) // 3, height=200)
    assert view.lod == 1 and view.height == 200 and len(view._triangles) == 12 * len(room.mesh(lod=1))
    assert len(view._path) == 12 * len(room.poses)


def test_what_cannot_be_shown_is_refused(room: vx.Map) -> None:
    mesh = room.mesh()
    with pytest.raises(ValueError, match="no surface"):
        MapView(vx.Mesh(mesh.vertices, mesh.triangles[:0], mesh.normals, mesh.scales, None, None))
    with pytest.raises(ValueError, match="height"):
        MapView(room, height=0)
