// The surface in 3D: points coloured by a map, with their displacement magnified. Drag to turn, wheel or +/- to zoom.

import { make, options } from "./elements.js";
import { usualRange } from "./map_canvas.js";
import { cloud, newest, palettes, tried } from "./server.js";
import { listen } from "./stream.js";

const VERTEX = `
attribute vec3 place, moved; attribute float value;
uniform vec3 middle; uniform float size, magnified, turn, tilt, zoom, aspect, dots; uniform vec2 range; varying float colour;
void main() {
  vec3 p = (place + magnified * moved - middle) / size;
  p = vec3(cos(turn) * p.x + sin(turn) * p.z, p.y, cos(turn) * p.z - sin(turn) * p.x);
  p = vec3(p.x, cos(tilt) * p.y - sin(tilt) * p.z, sin(tilt) * p.y + cos(tilt) * p.z);
  gl_Position = vec4(zoom * p.x / aspect, zoom * p.y, -0.4 * p.z, 1.0);
  gl_PointSize = dots * zoom;
  colour = clamp((value - range.x) / (range.y - range.x), 0.0, 1.0);
}`;
const FRAGMENT = `
precision mediump float; uniform sampler2D palette; varying float colour;
void main() { gl_FragColor = texture2D(palette, vec2((colour * 255.0 + 0.5) / 256.0, 0.5)); }`;
const kept = { quantity: "w", magnified: 1, turn: 0.5, tilt: -0.5, zoom: 1.6 };

export function show(place) {
  const canvas = make("canvas", { class: "space", id: "space", tabindex: 0, role: "img", "aria-label": "Surface in 3D; arrow keys turn it, plus and minus zoom" });
  const scene = new Scene(canvas);
  const step = make("select", { id: "space-step", onchange: () => load() });
  const quantity = make("select", { id: "space-quantity", onchange: () => { kept.quantity = quantity.value; load(); } });
  const magnified = make("input", { type: "number", min: 0, step: "any", value: kept.magnified, oninput: () => { kept.magnified = Number(magnified.value); scene.draw(); } });
  const words = make("p", { class: "soft", role: "status" });
  place.replaceChildren(make("section", { class: "panel" }, make("div", { class: "row" }, make("label", {}, "Step", step),
    make("label", {}, "Colour", quantity), make("label", {}, "Displacement times", magnified)), canvas, words));
  const chosen = newest();
  const load = async () => {
    if (!step.value || !quantity.value) return;
    const of = `${quantity.value} of step ${step.value}`;
    const [points, colours] = await tried(chosen(Promise.all([cloud(step.value, quantity.value), palettes()]))) ?? [];
    if (!points) return;
    scene.take(points, colours.viridis);
    words.textContent = `${points.length / 7} points, coloured by ${of}; drag to turn, wheel to zoom`;
  };
  const watch = new ResizeObserver(() => scene.draw());
  watch.observe(canvas);
  const ends = [
    listen("quantities", (found) => { options(quantity, found.map(({ name }) => [name, name]), kept.quantity); load(); }),
    listen("steps", (found) => { const mapped = found.filter((each) => each.mapped === 2); options(step, mapped.map((each) => [each.step, String(each.step)]), mapped.at(-1)?.step); load(); }),
    () => watch.disconnect(),
  ];
  return () => ends.forEach((end) => end());
}

class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl", { preserveDrawingBuffer: true });
    if (!this.gl) return;
    this.program = link(this.gl);
    this.gl.useProgram(this.program);
    this.buffer = this.gl.createBuffer();
    this.turnBy(canvas);
  }

  turnBy(canvas) {
    canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
    canvas.onpointermove = (event) => event.buttons && this.turn(0.01 * event.movementX, 0.01 * event.movementY, 1);
    canvas.onwheel = (event) => { event.preventDefault(); this.turn(0, 0, Math.exp(-0.001 * event.deltaY)); };
    const keys = { ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, -0.1, 1], ArrowDown: [0, 0.1, 1], "+": [0, 0, 1.1], "-": [0, 0, 1 / 1.1] };
    canvas.onkeydown = (event) => { if (event.key in keys) { event.preventDefault(); this.turn(...keys[event.key]); } };
  }

  turn(turn, tilt, zoom) {
    kept.turn += turn; kept.tilt += tilt; kept.zoom *= zoom;
    this.draw();
  }

  take(points, colours) {
    const { gl } = this;
    if (!gl || !points.length) return;
    const along = (k) => points.filter((_, at) => at % 7 === k);
    const limits = [0, 1, 2].map((k) => { const values = along(k); return [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))]; });
    this.count = points.length / 7;
    this.middle = limits.map(([low, high]) => (low + high) / 2);
    this.size = Math.max(...limits.map(([low, high]) => high - low));
    this.range = usualRange(along(6));
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.STATIC_DRAW);
    for (const [name, width, offset] of [["place", 3, 0], ["moved", 3, 12], ["value", 1, 24]]) {
      const at = gl.getAttribLocation(this.program, name);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, width, gl.FLOAT, false, 28, offset);
    }
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, new Uint8Array(colours));
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.NEAREST);
    this.draw();
  }

  draw() {
    const { gl, canvas } = this;
    if (!gl || !this.count) return;
    [canvas.width, canvas.height] = [canvas.clientWidth * devicePixelRatio, canvas.clientHeight * devicePixelRatio];
    gl.viewport(0, 0, canvas.width, canvas.height);
    const at = (name) => gl.getUniformLocation(this.program, name), aspect = canvas.width / canvas.height;
    const dots = Math.max(1.5, (1.2 * canvas.height) / (2 * Math.sqrt(this.count)));
    gl.uniform3fv(at("middle"), this.middle);
    gl.uniform2fv(at("range"), this.range);
    const values = { size: this.size, magnified: kept.magnified, turn: kept.turn, tilt: kept.tilt, zoom: kept.zoom, aspect, dots };
    for (const [name, value] of Object.entries(values)) gl.uniform1f(at(name), value);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.drawArrays(gl.POINTS, 0, this.count);
  }
}

function link(gl) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}
