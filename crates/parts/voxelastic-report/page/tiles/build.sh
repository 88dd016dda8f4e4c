#!/usr/bin/env bash
# Bundles viewer.js with the packages it imports as viewer.min.js, which is what the command writes beside the tiles. Needs npm and its registry; run it
# after a change of viewer.js or of a version below.
set -euo pipefail
cd "$(dirname "$0")"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cp viewer.js "$work"
cd "$work"
npm init -y >/dev/null
npm install --silent --ignore-scripts three@0.187.0 3d-tiles-renderer@0.5.3 esbuild@0.28.2 >/dev/null
npx esbuild viewer.js --bundle --minify --format=esm --target=es2022 --legal-comments=none --outfile=viewer.min.js \
    --banner:js='/* Voxelastic viewer of tiles. Contains three.js (MIT) and 3d-tiles-renderer (Apache-2.0): see LICENCES.txt */'
cp viewer.min.js "$OLDPWD/viewer.min.js"
{
    printf 'viewer.min.js contains parts of these packages, unchanged but for bundling and minification.\n'
    for package in three 3d-tiles-renderer; do
        printf '\n== %s %s\n\n' "$package" "$(node -p "require('./node_modules/$package/package.json').version")"
        cat "node_modules/$package/LICENSE"
    done
} >"$OLDPWD/LICENCES.txt"
