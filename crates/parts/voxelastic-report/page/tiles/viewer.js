// The page that streams a map's tiles: three.js draws, 3d-tiles-renderer decides which tiles are loaded. build.sh bundles it as viewer.min.js.

import { Box3, Color, DirectionalLight, DoubleSide, HemisphereLight, MeshLambertMaterial, PerspectiveCamera, Scene, Sphere, Vector3, WebGLRenderer } from 'three';
import { EnvironmentControls, TilesRenderer } from '3d-tiles-renderer/three';

// Memory of loaded tiles: from which on tiles that are not shown are dropped, and from which on no more are loaded.
const KEEP_BYTES = 150e6;
const MOST_BYTES = 250e6;
// Error of a tile on the screen, in pixels, at which finer ones replace it, for the slider's middle; a step of it halves or doubles that.
const ERROR_PIXELS = 8;

// Frames a second below which less is drawn, and above which more is drawn again: machines without a graphics card draw in software.
const SLOW = 18;
const FAST = 40;
// The same in steps: how much larger the error on the screen may be, and how many pixels are drawn for each of the screen.
const STEPS = [[1, 1], [1.5, 1], [2, 0.75], [3, 0.6], [4, 0.5], [6, 0.5]];

const element = (id) => document.getElementById(id);
const renderer = new WebGLRenderer({ antialias: !isSoftware() });
const pixelRatio = Math.min(devicePixelRatio, 2);
renderer.setPixelRatio(pixelRatio);
document.body.prepend(renderer.domElement);

const scene = new Scene();
scene.background = new Color(0x12161c);
scene.add(new HemisphereLight(0xffffff, 0x556070, 2.2));
const sun = new DirectionalLight(0xffffff, 1.6);
sun.position.set(-1, -2, 3);
scene.add(sun);

const camera = new PerspectiveCamera(55, 1, 0.1, 1e5);
camera.up.set(0, 0, 1);

const material = new MeshLambertMaterial({ vertexColors: true, side: DoubleSide });
const tiles = new TilesRenderer(new URL('tileset.json', location.href).href);
tiles.lruCache.minBytesSize = KEEP_BYTES;
tiles.lruCache.maxBytesSize = MOST_BYTES;
tiles.errorTarget = ERROR_PIXELS;
tiles.setCamera(camera);
scene.add(tiles.group);

const controls = new EnvironmentControls(scene, camera, renderer.domElement);
// z is up.
controls.up.set(0, 0, 1);
controls.fallbackPlane.normal.set(0, 0, 1);
controls.adjustHeight = false;
controls.minDistance = 0.5;
controls.enableDamping = true;

// What tests and curious people look at.
const state = { ready: false, firstPictureMs: null, framesPerSecond: 0, adapts: true, step: 0, frames: 0, shown: 0, bytes: 0, problems: [], tiles, camera, controls, renderer, home };
window.voxelastic = state;

const problem = (what) => {
  state.problems.push(String(what));
  element('message').style.display = 'grid';
  element('message').textContent = String(what);
};
addEventListener('error', (event) => problem(event.message));
tiles.addEventListener('load-error', ({ error, url }) => problem(`cannot load ${url ?? 'a tile'}: ${error?.message ?? error}`));
tiles.addEventListener('load-root-tileset', () => {
  const about = tiles.rootTileset?.asset?.extras ?? {};
  element('title').textContent = document.title = about.title ?? 'Map';
  home();
});
tiles.addEventListener('load-model', ({ scene: model }) => {
  model.traverse((part) => {
    if (part.isMesh) {
      part.material.dispose();
      part.material = material;
    }
  });
  state.changed = true;
});
tiles.addEventListener('tile-visibility-change', () => { state.changed = true; });

// Whether the browser draws without a graphics card.
function isSoftware() {
  const context = document.createElement('canvas').getContext('webgl2');
  const names = context?.getExtension('WEBGL_debug_renderer_info');
  const name = names ? context.getParameter(names.UNMASKED_RENDERER_WEBGL) : '';
  context?.getExtension('WEBGL_lose_context')?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

// Draws less where frames take long, and more again where they do not.
function adapt() {
  const step = Math.min(Math.max(state.step + (state.framesPerSecond < SLOW) - (state.framesPerSecond > FAST), 0), STEPS.length - 1);
  if (step !== state.step) {
    state.step = step;
    renderer.setPixelRatio(pixelRatio * STEPS[step][1]);
    resize();
  }
  tiles.errorTarget = ERROR_PIXELS * 2 ** (2 - element('detail').value) * STEPS[step][0];
}

// Shows the whole map, from the south and above.
function home() {
  const box = new Box3();
  const ball = new Sphere();
  if (!tiles.getBoundingBox(box) || box.isEmpty()) {
    if (!tiles.getBoundingSphere(ball)) return;
    ball.getBoundingBox(box);
  }
  box.getBoundingSphere(ball);
  const distance = 0.9 * ball.radius / Math.sin((0.5 * camera.fov * Math.PI) / 180);
  camera.position.copy(ball.center).addScaledVector(new Vector3(-0.25, -0.75, 0.6).normalize(), distance);
  camera.lookAt(ball.center);
  camera.near = Math.max(0.05, 1e-4 * distance);
  camera.far = 20 * distance;
  camera.updateProjectionMatrix();
}

function resize() {
  camera.aspect = innerWidth / Math.max(innerHeight, 1);
  camera.updateProjectionMatrix();
  renderer.setSize(innerWidth, innerHeight);
  tiles.setResolutionFromRenderer(camera, renderer);
}
addEventListener('resize', resize);
element('home').addEventListener('click', home);
element('detail').addEventListener('input', adapt);
resize();

let since = performance.now();
let counted = 0;
function frame(now) {
  requestAnimationFrame(frame);
  controls.update();
  camera.updateMatrixWorld();
  tiles.update();
  renderer.render(scene, camera);
  state.frames += 1;
  counted += 1;
  state.shown = tiles.visibleTiles.size;
  state.bytes = tiles.lruCache.cachedBytes;
  if (state.firstPictureMs === null && state.shown > 0) state.firstPictureMs = performance.now();
  state.ready = state.shown > 0 && tiles.loadProgress === 1;
  if (now - since > 500) {
    state.framesPerSecond = (1000 * counted) / (now - since);
    [since, counted] = [now, 0];
    if (state.shown > 0 && state.adapts) adapt();
    element('figures').textContent = `${state.shown} tiles shown, ${renderer.info.render.triangles.toLocaleString('en')} triangles, ` +
      `${(state.bytes / 1e6).toFixed(0)} MB loaded, ${state.framesPerSecond.toFixed(0)} frames a second`;
  }
}
requestAnimationFrame(frame);
