// The page of the viewer begins.

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
