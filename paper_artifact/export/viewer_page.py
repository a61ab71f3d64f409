"""The HTML, CSS and JavaScript of the 3-D view; @TITLE@, @BACK@ and @DATA@ are filled in by `viewer`."""

PAGE = r"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>@TITLE@</title><link rel="icon" href="data:,">
<style>
html, body { margin: 0; height: 100%; overflow: hidden; background: #fff; color: #222; font: 14px/1.4 system-ui, sans-serif; }
body { display: flex; flex-direction: column; }
#bar { padding: 8px 12px 2px; border-bottom: 1px solid #ddd; }
#bar h1 { font-size: 15px; margin: 0 0 6px; font-weight: 600; }
#bar a { float: right; color: #2c5f8a; }
#bar button, #bar label { margin: 0 6px 6px 0; padding: 3px 10px; border: 1px solid #999; border-radius: 4px;
  background: #fff; color: inherit; font: inherit; cursor: pointer; display: inline-block; }
#bar button[aria-pressed=true] { background: #2c5f8a; border-color: #2c5f8a; color: #fff; }
#stage { position: relative; flex: 1; min-height: 0; }
canvas { position: absolute; width: 100%; height: 100%; display: block; touch-action: none; cursor: grab; }
#names { position: absolute; inset: 0; display: grid; pointer-events: none; }
#names div { padding: 4px 8px; font-weight: 600; border: 0 solid #ddd; border-width: 0 1px 1px 0; overflow: hidden; }
#names small { font-weight: 400; color: #666; display: block; }
#hint { position: absolute; right: 8px; bottom: 6px; color: #666; font-size: 12px; pointer-events: none; }
</style></head><body>
<div id="bar">@BACK@<h1>@TITLE@</h1><span id="parts"></span><label><input type="checkbox" id="light" checked> light</label><label><input type="checkbox" id="colours" checked> colours</label></div>
<div id="stage"><canvas id="view"></canvas><div id="names"></div><div id="hint">drag: orbit · wheel, pinch: zoom · double click: reset</div></div>
<script id="data" type="application/json">@DATA@</script>
<script>
"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const canvas = document.getElementById("view"), hint = document.getElementById("hint"), names = document.getElementById("names");
const gl = canvas.getContext("webgl", { antialias: true });

const add = (a, b, s = 1) => a.map((x, i) => x + s * b[i]), dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => { const length = Math.hypot(...a) || 1; return a.map(x => x / length); };

// Everything in radii around the centre: no loss of float precision far from the origin.
const local = point => add(point, data.centre, -1).map(x => x / data.radius);
const target = local(data.target), away = add(local(data.eye), target, -1);
const axis = unit(data.up), level = add(away, axis, -dot(away, axis));
// "front" and "side" span the ground; a first look along the axis leaves front open.
const front = unit(Math.hypot(...level) > 1e-6 ? level : cross(axis, Math.abs(axis[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]));
const side = cross(axis, front), off = Math.hypot(...target);
const start = { azimuth: 0, height: Math.asin(Math.max(-1, Math.min(1, dot(unit(away), axis)))), distance: Math.hypot(...away) || 2.6 };
let view = { ...start }, chosen = -1, parts = [];  // chosen: one part, -1: all

function bytes(text) { return Uint8Array.from(atob(text), c => c.charCodeAt(0)); }

function compile(type, source) {
  const shader = gl.createShader(type);
  gl.shaderSource(shader, source); gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  return shader;
}

function prepare() {
  const program = gl.createProgram();
  gl.attachShader(program, compile(gl.VERTEX_SHADER, `
    attribute vec3 position, normal, colour; uniform mat4 matrix; uniform vec3 eye; uniform float light, own;
    varying vec3 shown;
    void main() {
      float facing = abs(dot(normalize(eye - position), normal));
      shown = mix(vec3(0.72, 0.70, 0.66), colour, own) * mix(1.0, 0.35 + 0.65 * facing, light);
      gl_Position = matrix * vec4(position, 1.0);
    }`));
  gl.attachShader(program, compile(gl.FRAGMENT_SHADER,
    "precision mediump float; varying vec3 shown; void main() { gl_FragColor = vec4(shown, 1.0); }"));
  gl.linkProgram(program); gl.useProgram(program);
  const buffer = values => {
    const made = gl.createBuffer(); gl.bindBuffer(gl.ARRAY_BUFFER, made); gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    return made;
  };
  parts = data.parts.map(part => {
    const p = new Float32Array(bytes(part.positions).buffer).map((x, i) => (x - data.centre[i % 3]) / data.radius);
    const n = new Float32Array(p.length);
    for (let i = 0; i < p.length; i += 9) {
      const u = [0, 1, 2].map(k => p[i + 3 + k] - p[i + k]), v = [0, 1, 2].map(k => p[i + 6 + k] - p[i + k]);
      const c = unit(cross(u, v));
      for (let k = 0; k < 9; k++) n[i + k] = c[k % 3];
    }
    return { corners: 3 * part.count, position: buffer(p), normal: buffer(n), colour: buffer(bytes(part.colours)) };
  });
  return program;
}

// Column-major; the camera looks at the target, the axis is up.
function matrices(aspect) {
  const ca = Math.cos(view.azimuth), sa = Math.sin(view.azimuth), ch = Math.cos(view.height), sh = Math.sin(view.height);
  const ground = add(front.map(x => x * ca), side, sa), back = add(ground.map(x => x * ch), axis, sh);
  const right = add(side.map(x => x * ca), front, -sa), up = cross(back, right), eye = add(target, back, view.distance);
  const f = 1 / Math.tan(0.436), near = Math.max(0.01, view.distance - off - 1.1), far = view.distance + off + 1.1;
  const sx = f / Math.max(aspect, 1e-6) * Math.min(1, aspect), sy = f * Math.min(1, aspect);
  const a = (far + near) / (near - far), b = 2 * far * near / (near - far), m = new Float32Array(16);
  for (let k = 0; k < 3; k++) {
    m[4 * k] = sx * right[k]; m[4 * k + 1] = sy * up[k]; m[4 * k + 2] = a * back[k]; m[4 * k + 3] = -back[k];
  }
  m[12] = -sx * dot(right, eye); m[13] = -sy * dot(up, eye); m[14] = -a * dot(back, eye) + b; m[15] = dot(back, eye);
  return { matrix: m, eye };
}

const shown = () => chosen < 0 ? data.parts.map((_, i) => i) : [chosen];

// The grid of equal cells in which the smaller side of a cell is largest.
function grid(count, width, height) {
  let best = [1, count], most = 0;
  for (let columns = 1; columns <= count; columns++) {
    const rows = Math.ceil(count / columns), size = Math.min(width / columns, height / rows);
    if (size > most) { most = size; best = [columns, rows]; }
  }
  return best;
}

let program = null, waiting = false;
function draw() {
  waiting = false;
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map(length => Math.max(1, Math.round(length * ratio)));
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const cells = shown(), [columns, rows] = grid(cells.length, width, height);
  names.style.gridTemplate = `repeat(${rows}, 1fr) / repeat(${columns}, 1fr)`;
  gl.enable(gl.SCISSOR_TEST); gl.clearColor(1, 1, 1, 1); gl.enable(gl.DEPTH_TEST);
  const edge = (k, count, length) => Math.round(k * length / count);
  for (let row = 0; row < rows; row++) for (let column = 0; column < columns; column++) {
    const x = edge(column, columns, width), w = edge(column + 1, columns, width) - x;
    const y = height - edge(row + 1, rows, height), h = height - edge(row, rows, height) - y;
    gl.viewport(x, y, w, h); gl.scissor(x, y, w, h); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const index = cells[row * columns + column];
    if (index !== undefined) paint(parts[index], w / h);
  }
}
function paint(part, aspect) {
  const { matrix, eye } = matrices(aspect), place = name => gl.getUniformLocation(program, name);
  gl.uniformMatrix4fv(place("matrix"), false, matrix);
  gl.uniform3fv(place("eye"), eye);
  gl.uniform1f(place("light"), document.getElementById("light").checked ? 1 : 0);
  gl.uniform1f(place("own"), document.getElementById("colours").checked ? 1 : 0);
  const bind = (name, made, type, normalised) => {
    const at = gl.getAttribLocation(program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, made); gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, 3, type, normalised, 0, 0);
  };
  bind("position", part.position, gl.FLOAT, false);
  bind("normal", part.normal, gl.FLOAT, false);
  bind("colour", part.colour, gl.UNSIGNED_BYTE, true);
  gl.drawArrays(gl.TRIANGLES, 0, part.corners);
}
function redraw() { if (program && !waiting) { waiting = true; requestAnimationFrame(draw); } }

function zoom(factor) {
  view.distance = Math.min(12, Math.max(Math.min(0.3, start.distance / 4), view.distance * factor));
  redraw();
}

const fingers = new Map();
canvas.addEventListener("pointerdown", e => {
  fingers.set(e.pointerId, [e.clientX, e.clientY]);
  canvas.setPointerCapture(e.pointerId);
});
for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, e => fingers.delete(e.pointerId));
canvas.addEventListener("pointermove", e => {
  const last = fingers.get(e.pointerId);
  if (!last) return;
  const spread = () => { const [p, q] = [...fingers.values()]; return Math.hypot(p[0] - q[0], p[1] - q[1]) || 1; };
  const before = fingers.size === 2 ? spread() : 0;
  fingers.set(e.pointerId, [e.clientX, e.clientY]);
  if (fingers.size === 2) { zoom(before / spread()); return; }
  view.azimuth -= (e.clientX - last[0]) * 0.008;
  view.height = Math.min(1.57, Math.max(-1.57, view.height + (e.clientY - last[1]) * 0.008));
  redraw();
});
canvas.addEventListener("wheel", e => { e.preventDefault(); zoom(Math.exp(e.deltaY * 0.001)); }, { passive: false });
canvas.addEventListener("dblclick", () => { view = { ...start }; redraw(); });
window.addEventListener("resize", redraw);
for (const box of ["light", "colours"]) document.getElementById(box).addEventListener("change", redraw);

function choose(index) {
  chosen = index;
  document.querySelectorAll("#parts button").forEach(b => b.setAttribute("aria-pressed", String(b.value === String(index))));
  names.replaceChildren(...shown().map(i => {
    const name = document.createElement("div"), count = document.createElement("small");
    count.textContent = `${data.parts[i].count} triangles`;
    name.append(data.parts[i].name, count);
    return name;
  }));
  redraw();
}
if (data.parts.length > 1) [["all", -1], ...data.parts.map((part, i) => [part.name, i])].forEach(([name, i]) => {
  const button = document.createElement("button");
  button.textContent = name; button.value = i;
  button.addEventListener("click", () => choose(i));
  document.getElementById("parts").append(button);
});
choose(-1);
if (gl) { program = prepare(); redraw(); } else { hint.textContent = "This browser offers no WebGL, so nothing can be drawn."; }
</script></body></html>
"""  # noqa: E501
