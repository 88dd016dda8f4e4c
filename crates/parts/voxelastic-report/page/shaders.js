// The programs of the graphics card. Surfaces and lines go into a picture of colours and one of distances; a last pass darkens what lies
// behind a nearer edge (eye-dome lighting: Boucheny 2009), which shows shapes that have no texture.

/** Distance from the viewer, as a share of the farthest, in three bytes; the fourth says that there is something. */
const PACK = `
vec4 packed(float d) {
  d = clamp(d, 0.0, 0.9999999);
  vec3 e = fract(d * vec3(1.0, 255.0, 65025.0));
  return vec4(e - vec3(e.yz / 255.0, 0.0), 1.0);
}`;

const SURFACE_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 at;     // shares of 65535 steps
layout(location = 1) in vec2 facing;
layout(location = 2) in vec3 values; // intensity, scale, error, each a share of 255
layout(location = 3) in vec3 tint;
uniform mat4 toMap, toScreen;
out vec3 map, normal, own;
out float intensity, error, away;
flat out float level;
void main() {
  vec4 m = toMap * vec4(at * 65535.0, 1.0);
  map = m.xyz;
  vec2 f = facing * 2.0 - 1.0;
  vec3 n = vec3(f, 1.0 - abs(f.x) - abs(f.y));
  float t = max(-n.z, 0.0);
  n.xy += vec2(n.x >= 0.0 ? -t : t, n.y >= 0.0 ? -t : t);
  normal = mat3(toMap) * normalize(n);
  intensity = values.x;
  level = floor(values.y * 255.0 + 0.5);
  error = values.z * 255.0;
  own = tint;
  gl_Position = toScreen * m;
  away = gl_Position.w;
}`;

const SURFACE_FRAGMENT = `#version 300 es
precision highp float;
in vec3 map, normal, own;
in float intensity, error, away;
flat in float level;
uniform int mode;            // 0 height, 1 submap, 2 intensity, 3 scale, 4 error, 5 the scans' own
uniform vec3 submapColour, eye, unknown;
uniform vec2 heights, slice;
uniform float farthest;
uniform bool backs;
uniform sampler2D ramp;
layout(location = 0) out vec4 colour;
layout(location = 1) out vec4 distance;
${PACK}
vec3 look(float t) { return texture(ramp, vec2(clamp(t, 0.0, 1.0) * 0.99609375 + 0.001953125, 0.5)).rgb; }
void main() {
  if (map.z > slice.y || map.z < slice.x || (!gl_FrontFacing && !backs)) discard;
  vec3 c;
  if (mode == 0) c = look((map.z - heights.x) / (heights.y - heights.x));
  else if (mode == 1) c = submapColour;
  else if (mode == 2) c = look(intensity);
  else if (mode == 3) c = look(1.0 - level / 3.0);
  else if (mode == 4) c = error > 254.5 ? unknown : look(error / 254.0);
  else c = own;
  vec3 n = normalize(normal) * (gl_FrontFacing ? 1.0 : -1.0);
  vec3 view = normalize(eye - map);
  vec3 side = normalize(cross(vec3(0.0, 0.0, 1.0), view) + vec3(1e-5, 0.0, 0.0));
  float key = max(dot(n, normalize(view * 0.55 + side * 0.35 + vec3(0.0, 0.0, 0.75))), 0.0);
  float sky = 0.5 + 0.5 * n.z;
  float light = 0.42 + 0.2 * sky + 0.52 * key;
  c = pow(c, vec3(2.2)) * light;
  if (!gl_FrontFacing) c *= 0.42;
  colour = vec4(pow(min(c, 1.0), vec3(1.0 / 2.2)), 1.0);
  distance = packed(away / farthest);
}`;

// A line is a quad per segment, as wide as wanted in pixels.
const LINE_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec2 corner; // along: 0 or 1, across: -1 or 1
layout(location = 1) in vec3 from;
layout(location = 2) in vec3 to;
layout(location = 3) in vec4 tint;   // colour, width in pixels / 255
uniform mat4 toScreen;
uniform vec2 screen;                 // pixels
uniform float widen;
out vec3 colour3;
out float away, height;
void main() {
  vec4 a = toScreen * vec4(from, 1.0), b = toScreen * vec4(to, 1.0);
  float near = 0.05;
  if (a.w < near && b.w < near) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  if (a.w < near) a = mix(a, b, (near - a.w) / (b.w - a.w));
  if (b.w < near) b = mix(b, a, (near - b.w) / (a.w - b.w));
  vec2 d = (b.xy / b.w - a.xy / a.w) * screen;
  d = length(d) > 1e-4 ? normalize(d) : vec2(1.0, 0.0);
  vec4 p = corner.x < 0.5 ? a : b;
  float wide = tint.a * 255.0 * widen;
  vec2 shift = vec2(-d.y, d.x) * corner.y + d * (corner.x * 2.0 - 1.0) * 0.5;
  p.xy += shift * wide / screen * p.w;
  p.z -= 0.0004 * p.w;
  gl_Position = p;
  colour3 = tint.rgb;
  away = p.w;
  height = mix(from.z, to.z, corner.x);
}`;

const LINE_FRAGMENT = `#version 300 es
precision highp float;
in vec3 colour3;
in float away, height;
uniform float farthest, strength;
uniform vec2 slice;
layout(location = 0) out vec4 colour;
layout(location = 1) out vec4 distance;
${PACK}
void main() {
  if (height > slice.y || height < slice.x) discard;
  colour = vec4(colour3, strength);
  distance = packed(away / farthest);
}`;

const SCREEN_VERTEX = `#version 300 es
out vec2 place;
void main() {
  place = vec2(gl_VertexID == 1 ? 2.0 : 0.0, gl_VertexID == 2 ? 2.0 : 0.0);
  gl_Position = vec4(place * 2.0 - 1.0, 0.0, 1.0);
}`;

const SCREEN_FRAGMENT = `#version 300 es
precision highp float;
in vec2 place;
uniform sampler2D colours, distances;
uniform vec2 size;     // pixels of the pictures
uniform int samples;   // of the pictures to each pixel of the screen, along a side
uniform float radius, strength;
uniform vec3 top, bottom;
out vec4 colour;
float away(ivec2 p) {
  vec4 d = texelFetch(distances, clamp(p, ivec2(0), ivec2(size) - 1), 0);
  return d.a < 0.5 ? 1.0 : dot(d.rgb, vec3(1.0, 1.0 / 255.0, 1.0 / 65025.0));
}
void main() {
  ivec2 first = ivec2(floor(gl_FragCoord.xy)) * samples;
  vec3 sky = mix(bottom, top, place.y), sum = vec3(0.0);
  for (int i = 0; i < samples * samples; i++) {
    ivec2 p = first + ivec2(i % samples, i / samples);
    vec4 c = texelFetch(colours, min(p, ivec2(size) - 1), 0);
    float here = log2(max(away(p), 1e-6)), hidden = 0.0;
    for (int k = 0; k < 8; k++) {
      float angle = float(k) * 0.785398;
      float there = log2(max(away(p + ivec2(round(vec2(cos(angle), sin(angle)) * radius))), 1e-6));
      hidden += clamp(here - there, 0.0, 0.6);
    }
    float shade = exp(-strength * hidden);
    sum += c.a < 0.01 ? sky * mix(1.0, shade, 0.25) : mix(sky, c.rgb, c.a) * shade;
  }
  colour = vec4(sum / float(samples * samples), 1.0);
}`;

function program(gl, vertex, fragment) {
  const p = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) || "a shader does not compile");
    gl.attachShader(p, shader);
  }
  gl.linkProgram(p);
  if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p) || "a program does not link");
  const uniforms = {};
  for (let i = 0; i < gl.getProgramParameter(p, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(p, i);
    uniforms[name] = gl.getUniformLocation(p, name);
  }
  return { p, uniforms };
}
