// A client of Foxglove's protocol by Foxglove: `client.mjs ADDRESS FOLDER`, with the packages of .ci/npm. Subscribes to all that is offered, reads the messages by their
// definitions, and writes what it got to FOLDER/taken.json once it has some of each topic and nothing has come for a while.
import { createRequire } from "node:module";
import { renameSync, writeFileSync } from "node:fs";
import { join } from "node:path";

const require = createRequire(join(process.env.VOXELASTIC_NODE_MODULES, "x.js"));
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const { parse } = require("@foxglove/rosmsg");
const { WebSocket } = require("ws");

const [address, folder] = process.argv.slice(2);
// The server speaks the protocol under its newer name.
const client = new FoxgloveClient({ ws: new WebSocket(`ws://${address}`, ["foxglove.sdk.v1"]) });
const topics = new Map(), taken = {};
client.on("advertise", (channels) => {
  for (const channel of channels) {
    if (channel.encoding !== "cdr" || channel.schemaEncoding !== "ros2msg") throw new Error(`${channel.topic}: ${channel.encoding}, ${channel.schemaEncoding}`);
    topics.set(client.subscribe(channel.id), { ...channel, reader: new MessageReader(parse(channel.schema, { ros2: true })) });
    taken[channel.topic] = [];
  }
});
client.on("message", ({ subscriptionId, data }) => {
  const { topic, reader } = topics.get(subscriptionId);
  taken[topic].push(reader.readMessage(data));
});
client.on("error", (error) => { throw error; });

const own = (name) => taken[`/voxelastic/${name}`], latest = (messages) => messages[messages.length - 1];
const stamp = ({ sec, nsec, nanosec }) => sec + 1e-9 * (nsec ?? nanosec);
const OWN = ["surface", "surface_points", "octomap", "grid", "path", "submaps", "frontier", "explore_path", "explore_goal"];
// Transforms come for ever: the surface is what is waited for.
let parts = 0, since = Date.now();
setInterval(() => {
  const count = own("surface_points")?.length ?? 0;
  if (count !== parts) [parts, since] = [count, Date.now()];
  if (!OWN.every((name) => own(name)?.length) || !taken["/tf"].length || Date.now() - since < 1500) return;
  const points = own("surface_points"), path = latest(own("path")), grid = latest(own("grid")), octomap = latest(own("octomap"));
  const transform = latest(taken["/tf"]).transforms[0];
  writeFileSync(join(folder, "points"), Buffer.concat(points.map((message) => Buffer.from(message.data))));
  writeFileSync(join(folder, "octomap"), Buffer.from(Uint8Array.from(octomap.data)));
  const cells = Array.from(grid.data);
  const xyz = ({ x, y, z }) => [x, y, z];
  const summary = {
    explore_path: latest(own("explore_path")).poses.map(({ pose }) => xyz(pose.position)),
    explore_goal: xyz(latest(own("explore_goal")).pose.position),
    frontier: latest(own("frontier")).markers.filter((m) => m.type === 1 && m.action === 0).map((m) => [...xyz(m.pose.position), ...xyz(m.scale)]),
    point_step: latest(points).point_step,
    path: path.poses.map(({ pose: { position: p } }) => [p.x, p.y, p.z]),
    stamps: path.poses.map(({ header }) => stamp(header.stamp)),
    submaps: latest(own("submaps")).poses.length,
    resolution: octomap.resolution,
    grid: [grid.info.width, grid.info.height, cells.length, cells.filter((c) => c === 0).length, cells.filter((c) => c === 100).length],
    tf: [transform.header.frame_id, transform.child_frame_id, transform.transform.translation.x],
    corners: own("surface").reduce((sum, { markers }) => sum + markers.reduce((s, marker) => s + marker.points.length, 0), 0),
  };
  writeFileSync(join(folder, "taken.tmp"), JSON.stringify(summary));
  renameSync(join(folder, "taken.tmp"), join(folder, "taken.json"));
  process.exit(0);
}, 100);
