// The surface in 3D: points coloured by a map, with their displacement magnified. Drag to turn, wheel or +/- to zoom.

import { draw, make, number, options, patch } from "./elements.js";
import { t } from "./language.js";
import { colourBar, usualRange } from "./map_canvas.js";
import { numberField } from "./numbers.js";
import { cloud, newest, palettes, tried } from "./server.js";
import { listenShown, shown } from "./shown.js";

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
const AXES = ["x", "y", "z"];
const kept = { quantity: "w", step: null, follow: true, magnified: 1, turn: 0.5, tilt: -0.5, zoom: 1.6 };

export function show(place) {
  const canvas = make("canvas", { class: "space", id: "space", tabindex: 0, role: "img", "aria-label": t("Surface in 3D; arrow keys turn it, plus and minus zoom") });
  const axes = draw("svg", { class: "axes" }), bar = make("canvas", { width: 256, height: 1 }), low = make("span"), high = make("span");
  const scene = new Scene(canvas, (lines) => patch(axes, ...lines));
  const step = make("select", { id: "space-step", onchange: () => { kept.step = step.value; kept.follow = step.selectedIndex === step.length - 1; load(); } });
  const quantity = make("select", { id: "space-quantity", onchange: () => { kept.quantity = quantity.value; load(); } });
  const magnified = numberField({ id: "magnified", min: 0, value: kept.magnified, changed: () => { kept.magnified = magnified.found() ?? 1; scene.draw(); } });
  const words = make("p", { class: "soft", role: "status" }, scene.gl ? t("No surface has been measured yet.") : t("This browser has no WebGL, which draws the surface."));
  place.replaceChildren(make("section", { class: "panel" }, make("div", { class: "row" }, make("label", {}, t("Step"), step),
    make("label", {}, t("Colour"), quantity), make("label", {}, t("Displacement times"), magnified.input)),
  make("div", { class: "picture" }, canvas, axes), make("div", { class: "bar", id: "space-bar" }, low, bar, high), words));
  const chosen = newest();
  const load = async () => {
    if (!step.value || !quantity.value || !scene.gl) return;
    const of = { map: quantity.value, step: step.value }, found = (shown("quantities") ?? []).find(({ name }) => name === quantity.value);
    const [points, colours] = await tried(chosen(Promise.all([cloud(step.value, quantity.value), palettes()]))) ?? [];
    if (!points) return;
    scene.take(points, colours.viridis);
    [low.textContent, high.textContent] = scene.range.map((value) => `${number(value / found.factor)} ${found.unit}`);
    colourBar(bar, colours.viridis);
    words.textContent = t("{points} points, coloured by {map} of step {step}; drag to turn, wheel to zoom", { points: points.length / 7, ...of });
  };
  const watch = new ResizeObserver(() => scene.draw());
  watch.observe(canvas);
  const ends = [
    listenShown("quantities", (found) => { options(quantity, found.map(({ name }) => [name, name]), kept.quantity); load(); }),
    listenShown("steps", (found) => {
      const mapped = found.filter((each) => each.mapped === 2);
      if (kept.follow) kept.step = mapped.at(-1)?.step ?? null;
      options(step, mapped.map((each) => [each.step, String(each.step)]), kept.step);
      load();
    }),
    () => watch.disconnect(),
  ];
  return () => ends.forEach((end) => end());
}

class Scene {
  // `drawn` is called with the elements of the axes after each change of the view.
  constructor(canvas, drawn) {
    this.canvas = canvas;
    this.drawn = drawn;
    this.range = [NaN, NaN];
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
    this.limits = limits;
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
    this.drawn(this.axes());
  }

  // Where a point [m] is on the canvas [CSS pixel], as in the vertex shader.
  project(point) {
    const [x, y, z] = point.map((value, k) => (value - this.middle[k]) / this.size), { turn, tilt, zoom } = kept;
    const across = Math.cos(turn) * x + Math.sin(turn) * z, deep = Math.cos(turn) * z - Math.sin(turn) * x;
    const up = Math.cos(tilt) * y - Math.sin(tilt) * deep, { clientWidth: width, clientHeight: height } = this.canvas;
    return [((zoom * across * height) / width + 1) * 0.5 * width, (1 - zoom * up) * 0.5 * height];
  }

  // The three edges of the box around the points, from its lowest corner, with both ends in mm.
  axes() {
    const corner = this.limits.map(([low]) => low), [a, b] = this.project(corner);
    return this.limits.flatMap(([low, high], k) => {
      const [c, d] = this.project(corner.map((value, other) => (other === k ? high : value)));
      const text = t("{axis}: {low} to {high} mm", { axis: AXES[k], low: number(1e3 * low), high: number(1e3 * high) });
      const line = (name) => draw("line", { class: name, x1: a, y1: b, x2: c, y2: d });
      return [line("halo"), line("axis"), draw("text", { x: c, y: d, "text-anchor": "middle" }, text)];
    });
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
