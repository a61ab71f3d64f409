"""The HTML, CSS and JavaScript of the 3-D view; @TITLE@ and @DATA@ are filled in by `viewer`."""

PAGE = r"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>@TITLE@</title>
<style>
html, body { margin: 0; height: 100%; overflow: hidden; background: #fff; color: #222; font: 14px/1.4 system-ui, sans-serif; }
canvas { width: 100%; height: 100%; display: block; touch-action: none; cursor: grab; }
#bar { position: absolute; left: 12px; top: 10px; right: 12px; pointer-events: none; }
#bar h1 { font-size: 15px; margin: 0 0 6px; font-weight: 600; }
#bar button, #bar label { pointer-events: auto; margin: 0 6px 6px 0; padding: 3px 10px;
  border: 1px solid #999; border-radius: 4px; background: #ffffffcc; color: inherit; font: inherit;
  cursor: pointer; display: inline-block; }
#bar button[aria-pressed=true] { background: #2c5f8a; border-color: #2c5f8a; color: #fff; }
#hint { position: absolute; left: 12px; bottom: 8px; color: #666; font-size: 12px; pointer-events: none; }
</style></head><body>
<canvas id="view"></canvas>
<div id="bar"><h1>@TITLE@</h1><span id="parts"></span><label><input type="checkbox" id="light"> light</label></div>
<div id="hint">drag: orbit · wheel: zoom · double click: reset</div>
<script id="data" type="application/json">@DATA@</script>
<script>
"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const canvas = document.getElementById("view"), hint = document.getElementById("hint");
const gl = canvas.getContext("webgl", { antialias: true });
const start = { azimuth: 0.6, height: 0.35, distance: 2.6 };
let view = { ...start }, chosen = 0, parts = [];

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
    attribute vec3 position, normal, colour; uniform mat4 matrix; uniform vec3 eye; uniform float light;
    varying vec3 shown;
    void main() {
      float facing = abs(dot(normalize(eye - position), normal));
      shown = colour * mix(1.0, 0.35 + 0.65 * facing, light);
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
    // Positions relative to the centre, in radii: no loss of float precision far from the origin.
    const p = new Float32Array(bytes(part.positions).buffer).map((x, i) => (x - data.centre[i % 3]) / data.radius);
    const n = new Float32Array(p.length);
    for (let i = 0; i < p.length; i += 9) {
      const u = [0, 1, 2].map(k => p[i + 3 + k] - p[i + k]), v = [0, 1, 2].map(k => p[i + 6 + k] - p[i + k]);
      const c = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      const length = Math.hypot(...c) || 1;
      for (let k = 0; k < 9; k++) n[i + k] = c[k % 3] / length;
    }
    return { corners: 3 * part.count, position: buffer(p), normal: buffer(n), colour: buffer(bytes(part.colours)) };
  });
  return program;
}

// Column-major; the world's +z is up, the camera looks at the centre.
function matrices(aspect) {
  const ca = Math.cos(view.azimuth), sa = Math.sin(view.azimuth), ch = Math.cos(view.height), sh = Math.sin(view.height);
  const back = [ca * ch, sa * ch, sh], right = [-sa, ca, 0], up = [-ca * sh, -sa * sh, ch];
  const eye = back.map(x => x * view.distance);
  const f = 1 / Math.tan(0.436), near = Math.max(0.01, view.distance - 1.5), far = view.distance + 1.5;
  const sx = f / Math.max(aspect, 1e-6) * Math.min(1, aspect), sy = f * Math.min(1, aspect);
  const a = (far + near) / (near - far), b = 2 * far * near / (near - far), m = new Float32Array(16);
  for (let k = 0; k < 3; k++) {
    m[4 * k] = sx * right[k]; m[4 * k + 1] = sy * up[k]; m[4 * k + 2] = a * back[k]; m[4 * k + 3] = -back[k];
  }
  m[14] = -a * view.distance + b; m[15] = view.distance;
  return { matrix: m, eye };
}

let program = null, waiting = false;
function draw() {
  waiting = false;
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map(side => Math.max(1, Math.round(side * ratio)));
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  gl.viewport(0, 0, width, height); gl.clearColor(1, 1, 1, 1); gl.enable(gl.DEPTH_TEST);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  const { matrix, eye } = matrices(width / height), part = parts[chosen];
  gl.uniformMatrix4fv(gl.getUniformLocation(program, "matrix"), false, matrix);
  gl.uniform3fv(gl.getUniformLocation(program, "eye"), eye);
  gl.uniform1f(gl.getUniformLocation(program, "light"), document.getElementById("light").checked ? 1 : 0);
  const bind = (name, made, type, normalised) => {
    const place = gl.getAttribLocation(program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, made); gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 3, type, normalised, 0, 0);
  };
  bind("position", part.position, gl.FLOAT, false);
  bind("normal", part.normal, gl.FLOAT, false);
  bind("colour", part.colour, gl.UNSIGNED_BYTE, true);
  gl.drawArrays(gl.TRIANGLES, 0, part.corners);
}
function redraw() { if (!waiting) { waiting = true; requestAnimationFrame(draw); } }

function zoom(factor) { view.distance = Math.min(12, Math.max(1.05, view.distance * factor)); redraw(); }

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
document.getElementById("light").addEventListener("change", redraw);

function choose(index) {
  chosen = index;
  [...document.querySelectorAll("#parts button")].forEach((b, i) => b.setAttribute("aria-pressed", String(i === index)));
  redraw();
}
data.parts.forEach((part, i) => {
  const button = document.createElement("button");
  button.textContent = `${part.name} (${part.count} triangles)`;
  button.addEventListener("click", () => choose(i));
  document.getElementById("parts").append(button);
});
if (gl) { program = prepare(); choose(0); } else { hint.textContent = "This browser offers no WebGL, so nothing can be drawn."; }
</script></body></html>
"""  # noqa: E501
