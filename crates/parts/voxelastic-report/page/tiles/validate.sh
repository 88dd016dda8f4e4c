#!/usr/bin/env bash
# Checks a folder of tiles: each file of triangles by Khronos' validator of glTF, and the tilesets by what 3D Tiles 1.1 asks of them (validate.cjs). Prints JSON; exit code 1
# if anything is wrong, 2 if the validator cannot be had. Needs node, npm and its registry.
#
#     crates/parts/voxelastic-report/page/tiles/validate.sh tiles/
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
tiles=$(cd "$1" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
{ npm init -y && npm install --no-audit --no-fund --ignore-scripts gltf-validator@2.0.0-dev.3.10; } >/dev/null 2>npm.log || { printf 'gltf-validator cannot be installed: %s\n' "$(tail -n 1 npm.log)" >&2; exit 2; }
cp "$here/validate.cjs" .
node validate.cjs "$tiles"
