// Checks tiles: see validate.sh.

const fs = require('fs');
const path = require('path');
const validator = require('gltf-validator');

const folder = process.argv[2];
const wrong = [];
const seen = { tilesets: 0, tiles: 0, glb: 0 };
const complain = (where, what) => wrong.push(`${where}: ${what}`);
// Of rounding to f32 and back, metres.
const SLACK = 1e-3;

const isNumber = (value) => typeof value === 'number' && Number.isFinite(value);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

// Lowest and highest corner of a box around the axes that a volume lies in.
function range(box, where) {
  if (!Array.isArray(box) || box.length !== 12 || !box.every(isNumber)) {
    complain(where, 'boundingVolume.box is not twelve numbers');
    return null;
  }
  const axes = [box.slice(3, 6), box.slice(6, 9), box.slice(9, 12)];
  if (axes[0].reduce((sum, c, k) => sum + c * cross(axes[1], axes[2])[k], 0) < 0) complain(where, 'the axes of the box are left-handed');
  const half = [0, 1, 2].map((k) => axes.reduce((sum, axis) => sum + Math.abs(axis[k]), 0));
  return [0, 1, 2].map((k) => [box[k] - half[k], box[k] + half[k]]);
}

function tile(one, parent, where, base) {
  seen.tiles += 1;
  const inside = range(one.boundingVolume?.box, where);
  if (inside && parent.range && inside.some(([low, high], k) => low < parent.range[k][0] - SLACK || high > parent.range[k][1] + SLACK)) {
    complain(where, 'its bounding volume reaches out of that of its parent');
  }
  if (!isNumber(one.geometricError) || one.geometricError < 0) complain(where, `geometricError ${one.geometricError}`);
  else if (one.geometricError > parent.error) complain(where, `geometricError ${one.geometricError} is larger than that of its parent, ${parent.error}`);
  if (parent.isRoot && !['ADD', 'REPLACE'].includes(one.refine)) complain(where, 'the root has no refine');
  if (one.refine !== undefined && !['ADD', 'REPLACE'].includes(one.refine)) complain(where, `refine ${one.refine}`);
  if (one.transform !== undefined && (one.transform.length !== 16 || !one.transform.every(isNumber))) complain(where, 'transform is not sixteen numbers');
  if (one.children !== undefined && one.children.length === 0) complain(where, 'children is empty');
  if (one.content !== undefined) {
    const file = path.join(base, decodeURIComponent(one.content.uri ?? ''));
    if (!fs.existsSync(file) || !fs.statSync(file).isFile()) complain(where, `content ${one.content.uri} does not exist`);
    else if (file.endsWith('.json')) {
      if (one.children !== undefined) complain(where, 'a tile with a tileset as content has children');
      tileset(file, { range: inside, error: one.geometricError, isRoot: false });
    }
    else used.add(file);
  }
  (one.children ?? []).forEach((child, k) => tile(child, { range: inside, error: one.geometricError, isRoot: false }, `${where}.${k}`, base));
}

const used = new Set();
function tileset(file, parent) {
  seen.tilesets += 1;
  const where = path.relative(folder, file);
  const content = JSON.parse(fs.readFileSync(file));
  if (!['1.0', '1.1'].includes(content.asset?.version)) complain(where, `asset.version ${content.asset?.version}`);
  if (!isNumber(content.geometricError)) complain(where, 'no geometricError');
  if (!content.root) complain(where, 'no root');
  else tile(content.root, { ...parent, isRoot: true, error: Math.min(parent.error, content.geometricError ?? Infinity) }, where, path.dirname(file));
}

(async () => {
  tileset(path.join(folder, 'tileset.json'), { range: null, error: Infinity });
  for (const file of used) {
    seen.glb += 1;
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)));
    for (const message of report.issues.messages.filter(({ severity }) => severity < 2)) complain(path.relative(folder, file), `${message.code} ${message.pointer ?? ''}: ${message.message}`);
  }
  console.log(JSON.stringify({ ...seen, wrong: wrong.length, first: wrong.slice(0, 20) }, null, 1));
  process.exitCode = wrong.length > 0 ? 1 : 0;
})();
