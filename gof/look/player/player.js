"use strict";

// The page: what is shown, who may change it, and a loop that draws it when it has changed.

const COLOUR = 0, SPEED = 1, UNCERTAINTY = 2;
const COLOURINGS = ["colour", "speed", "uncertainty"];
/** What each of the first buttons shows. */
const PRESETS = {
  flame: { colouring: COLOUR, lines: false, plate: true },
  motion: { colouring: SPEED, lines: true },
  uncertainty: { colouring: UNCERTAINTY, lines: false },
};
const TRUTH_OF = { [SPEED]: 3, [UNCERTAINTY]: 4 }; // how the true velocity colours the same Gaussians (splat.glsl)
const GUESSED_DEGREES = 20; // from the nearest camera on, a flame's shape is a guess
const FADE_DEGREES = 4; // a plate is true for its camera only: it is gone this far from it
const STILL_MS = 250; // after this the picture is drawn in full resolution
const ENLARGED = 2; // CSS pixels, at most, to a pixel of a recorded picture
const ROOM = 1.3; // widths of such a picture to its pane, so that what is turned out of it is seen
const NARROW = "(max-width: 760px)"; // as in style.css

const byId = (id) => document.getElementById(id);
const share = JSON.parse(byId("share").textContent);
const shaders = share.shaders;
/** Its results' Gaussians as numbers; the text that they came in is let go. */
function unpacked(results) {
  return results.map((result) => {
    const columns = unpack(result.header, bytes(result.data), share.first_s);
    result.data = null;
    return { count: result.header.count, emissive: result.header.emissive, columns };
  });
}
let clouds = unpacked(share.results);
const pictures = new Pictures(share.cameras);
const hasFrames = share.cameras.some((camera) => camera.frames);
const hasTruth = clouds.some(({ columns }) => columns.v_true);
const RECORDED = share.results.length; // the number of the pane beside the results' own
const WIPE = RECORDED + 1; // of the choice beside the panes

const state = {
  time: 0, playing: false, slow: 10, loop: true,
  camera: share.start, view: null, colouring: COLOUR, lines: false, plate: true, size: 1,
  panes: new Set([0]), wipe: null, // share of the picture, from the left, that is the filmed one; null: no wipe
};
let dirty = true;
let wake = () => {};
let touched = 0; // when the view was last changed by hand, ms
const QUALITIES = [1, 0.75, 0.5, 0.35]; // shares of the screen's pixels a side, while something moves
let quality = 0;
const measured = { sort: 0, interval: 0, shown: 0, frames: 0 };

// ---------------------------------------------------------------- sorting

function startSorter() {
  const worker = new Worker(URL.createObjectURL(new Blob([share.sorter], { type: "text/javascript" })));
  const waiting = [];
  worker.onmessage = ({ data }) => waiting.shift()(data);
  const kept = ["x0", "v", "t_mu", "t_sigma", "opacity"];
  giveSorter = () =>
    worker.postMessage({ clouds: clouds.map(({ columns }) => Object.fromEntries(kept.map((name) => [name, columns[name]]))) });
  giveSorter();
  return (question) =>
    new Promise((resolve) => {
      waiting.push(resolve);
      worker.postMessage(question);
    });
}

// ---------------------------------------------------------------- drawing

let drawer, sorted, giveSorter;

function homeView(camera = state.camera) {
  return cameraView(share.cameras[camera], share.centre);
}

function atCamera() {
  const home = homeView();
  const apart = Math.max(...home.axes.flat().map((value, i) => Math.abs(value - state.view.axes.flat()[i])));
  return Math.max(apart, Math.hypot(...add(home.eye, state.view.eye, -1)) / reach(home)) < 1e-3;
}

/** 1 where the camera stands, 0 some degrees away. */
function nearness(view) {
  const home = homeView();
  const turn = Math.max(...home.axes.map((axis, i) => Math.acos(Math.min(1, dot(axis, view.axes[i])))));
  const moved = Math.hypot(...add(home.eye, view.eye, -1)) / reach(home);
  return Math.max(0, 1 - Math.max(turn, moved) / ((FADE_DEGREES * Math.PI) / 180));
}

/** The camera that looks most nearly as the view does: its recorded picture is the one to compare with. */
function nearest() {
  const along = (camera) => dot(homeView(camera).axes[2], state.view.axes[2]);
  return share.cameras.reduce((best, _, i) => (along(i) > along(best) + 1e-9 ? i : best), state.camera);
}

/** Degrees between the view and the nearest camera that filmed; 0 where nobody knows which did. */
function awayFromCameras() {
  const along = share.cameras.slice(0, share.given).map((_, i) => dot(homeView(i).axes[2], state.view.axes[2]));
  return along.length ? (Math.acos(Math.min(1, Math.max(-1, ...along))) * 180) / Math.PI : 0;
}

/** Whether the filmed picture wipes over the reconstructed one: only in its camera's own view, for it has no other. */
function wiping() {
  if (state.wipe === null || !atCamera()) return false;
  const truth = state.colouring !== COLOUR && clouds[0].columns.v_true;
  return !!(truth || share.cameras[state.camera].frames?.every(Boolean));
}

/** Pixels of the canvas, at most, to a pixel of the recorded pictures: only while they are compared. */
function enlarged(ratio) {
  return state.wipe !== null || state.panes.has(RECORDED) ? ENLARGED * ratio : Infinity;
}

function frameAt(time) {
  const times = share.frame_s;
  if (!times.length) return -1;
  return times.reduce((best, t, i) => (Math.abs(t - time) < Math.abs(times[best] - time) ? i : best), 0);
}

/**
 * Rectangles [left, top, width, height] for so many panes: the grid in which the camera's picture is largest. Where it may
 * not be as large as its pane, panes side by side come near each other.
 */
function grid(count, width, height, camera, most) {
  const across = (columns) => lensIn(camera, width / columns, height / Math.ceil(count / columns), most).picture[2];
  let columns = 1;
  for (let c = 2; c <= count; c++) if (across(c) >= across(columns) * 0.999) columns = c;
  const rows = Math.ceil(count / columns);
  const used = columns > 1 && most < Infinity ? Math.min(width, columns * ROOM * across(columns)) : width;
  const edge = (i, parts, length) => Math.round((i * length) / parts);
  return Array.from({ length: count }, (_, i) => {
    const [column, row] = [i % columns, Math.floor(i / columns)];
    const [left, top] = [edge(column, columns, used), edge(row, rows, height)];
    return [left + Math.round((width - used) / 2), top, edge(column + 1, columns, used) - left, edge(row + 1, rows, height) - top];
  });
}

/** Draw what the state says, and what the panes are called. Resolves when it is on the canvas. */
async function paint(scale) {
  if (share.sampled) await goToInstant();
  const { time, colouring } = state;
  const view = swayed(state.view);
  const these = clouds;
  const wipe = wiping();
  const numbers = panes();
  if (wipe) numbers.splice(0, numbers.length, RECORDED, numbers.find((number) => number !== RECORDED));
  const shown = numbers.map((number) => (number === RECORDED ? 0 : number));
  const once = [...new Set(shown)]; // the recorded pane shows the first result's Gaussians
  const frame = frameAt(time);
  const here = atCamera();
  const filmed = here ? state.camera : nearest();
  const truth = !!clouds[0].columns.v_true; // where it is not known, the filmed picture stands in its place
  const filming = frame >= 0 && (truth ? colouring === COLOUR && (here || !state.lines) : true); // lines are in this view
  const [{ orders, ms }, plate, picture] = await Promise.all([
    sorted({ shown: once, time, eye: view.eye, forward: view.axes[2] }),
    state.plate && colouring === COLOUR ? pictures.plate(state.camera) : null,
    filming ? pictures.frame(filmed, frame) : null,
  ]);
  if (these !== clouds) return paint(scale); // others came while these were sorted
  const ratio = (window.devicePixelRatio || 1) * scale;
  const canvas = byId("canvas");
  const size = [canvas.clientWidth, canvas.clientHeight].map((length) => Math.max(1, Math.round(length * ratio)));
  drawer.resize(...size);
  const strength = nearness(view);
  const edge = wipe ? wipeEdge(...size, ratio) : 0;
  const rectangles = wipe ? numbers.map(() => [0, 0, ...size]) : grid(numbers.length, ...size, view.camera, enlarged(ratio));
  const shownPanes = rectangles.map((rectangle, i) => {
    const own = numbers[i] !== RECORDED;
    const known = !!clouds[shown[i]].columns.v_true;
    return {
      rectangle,
      part: !wipe ? rectangle : own ? [edge, 0, size[0] - edge, size[1]] : [0, 0, edge, size[1]],
      cloud: shown[i],
      splats: own || (known && colouring !== COLOUR),
      emissive: clouds[shown[i]].emissive && colouring === COLOUR, // other colours are no light
      colouring: own ? colouring : TRUTH_OF[colouring] ?? COLOUR,
      lines: !state.lines ? null : own ? "own" : known ? "true" : null,
      share: Math.min(1, share.lines / clouds[shown[i]].count),
      behind: own ? plate : picture,
      filmed: own ? view.camera : share.cameras[filmed],
      strength: own ? strength : 1,
    };
  });
  orders.forEach((rows, i) => drawer.order(once[i], rows));
  const largest = colouring === UNCERTAINTY ? share.uncertainty_max : share.speed_max;
  const shot = { view, time, grow: state.size, largest, fastest: share.speed_max, span: share.line_s, thick: 1.6 * ratio, enlarged: enlarged(ratio) };
  drawer.draw(shot, shownPanes);
  measured.sort = ms;
  measured.shown = orders.reduce((sum, rows) => sum + rows.length, 0);
  name(numbers, shownPanes, { frame, here, filmed, wipe }, ratio);
  placeDivider(wipe, ratio);
}

/** What every pane shows, at its corner; of a wipe, at the corner of its side. */
function name(numbers, shownPanes, shot, ratio) {
  const captions = byId("captions");
  while (captions.children.length > shownPanes.length) captions.lastChild.remove();
  shownPanes.forEach(({ rectangle, cloud, behind }, i) => {
    const p = captions.children[i] ?? captions.appendChild(document.createElement("p"));
    const [title, note] = caption(numbers[i], cloud, shot, behind);
    if (p.dataset.says !== title + note) {
      p.dataset.says = title + note;
      const small = document.createElement("small");
      small.textContent = note;
      p.replaceChildren(title, small);
    }
    const [left, top, width] = lensIn(share.cameras[state.camera], rectangle[2], rectangle[3], enlarged(ratio)).picture;
    const right = shot.wipe && i === 1;
    p.className = right ? "right" : "";
    p.style.width = right ? "" : `${(shot.wipe ? width / 2 : width) / ratio}px`;
    p.style.left = `${(rectangle[0] + left + (right ? width : 0)) / ratio}px`;
    p.style.top = `${(rectangle[1] + top) / ratio}px`;
  });
}

/** Where the filmed picture ends, px of the canvas from its left. */
function wipeEdge(width, height, ratio) {
  const [left, , across] = lensIn(share.cameras[state.camera], width, height, enlarged(ratio)).picture;
  return Math.round(left + across * shownWipe());
}

function placeDivider(wipe, ratio) {
  const divider = byId("wipe");
  divider.hidden = !wipe;
  if (!wipe) return;
  const { width, height } = byId("canvas");
  const [, top, , high] = lensIn(share.cameras[state.camera], width, height, enlarged(ratio)).picture;
  divider.style.left = `${wipeEdge(width, height, ratio) / ratio}px`;
  divider.style.top = `${top / ratio}px`;
  divider.style.height = `${high / ratio}px`;
}

/** Where a camera's number is what people read, its name is a file's. */
const cameraLabel = (camera) => `Camera ${camera + 1}`;
const resultLabel = (result) => (share.results.length > 1 ? share.results[result].name : "Reconstructed");

function caption(number, cloud, { frame, here, filmed, wipe }, behind) {
  const { colouring } = state;
  if (number !== RECORDED) {
    const away = awayFromCameras();
    const guess = away < GUESSED_DEGREES ? "" : `${Math.round(away)}\u00b0 from the nearest camera: its shape is a guess`;
    return [wipe || state.panes.size > 1 || share.results.length > 1 ? resultLabel(number) : "", guess];
  }
  const known = clouds[cloud].columns.v_true;
  const whose = `at the Gaussians of ${share.results.length > 1 ? share.results[cloud].name : "the reconstruction"}`;
  if (colouring === SPEED && known) return ["True speed", whose];
  if (colouring === UNCERTAINTY && known) return ["True error of the velocity", `of a component, ${whose}`];
  if (behind) {
    const held = share.held_out.includes(frame) ? ", held out" : "";
    const where = here ? "" : ", the nearest camera's own view";
    return [`Filmed, ${cameraLabel(filmed)}`, `frame ${frame + 1} of ${share.frame_s.length}${held}${where}`];
  }
  if (state.lines && known) return ["True velocity", whose];
  return ["Filmed", "this camera's pictures are not in this file"];
}

function change(byHand = false) {
  dirty = true;
  if (byHand) {
    touched = performance.now();
    setTimeout(() => change(), STILL_MS + 20);
  }
  show(); // controls answer at once, also where drawing takes long
  wake();
}

function moves() {
  return state.playing || sway.since !== null || performance.now() - touched < STILL_MS;
}

const animationFrame = () => new Promise((resolve) => requestAnimationFrame(resolve));

/** first: called once something is on the canvas. */
async function loop(first) {
  let before = 0;
  for (;;) {
    if (!dirty && !state.playing && sway.since === null) {
      await new Promise((resolve) => (wake = resolve));
      before = 0;
    }
    const now = await animationFrame();
    if (before) pace(now - before);
    if (state.playing) advance(before ? now - before : 0);
    before = now;
    dirty = false;
    try {
      await paint(moves() ? QUALITIES[quality] : 1);
    } catch (error) {
      fail(error);
      return;
    }
    show();
    first?.();
    first = null;
  }
}

/** Fewer pixels where the device is slow, more where it has time to spare; only while something moves. */
function pace(interval) {
  if (!moves() || interval > 5000) return;
  measured.interval = measured.interval ? measured.interval + 0.2 * (interval - measured.interval) : interval;
  const late = measured.interval > 45;
  measured.frames = late || measured.interval < 18 ? measured.frames + 1 : 0;
  const enough = late ? (measured.interval > 150 ? 1 : 5) : 90;
  if (measured.frames < enough) return;
  quality = Math.max(0, Math.min(QUALITIES.length - 1, quality + (late ? 1 : -1)));
  [measured.frames, measured.interval] = [0, 0];
}

function advance(ms) {
  state.time += Math.min(ms, 500) / 1e3 / state.slow;
  if (state.time <= share.length_s) return;
  if (state.loop && share.length_s > 0) state.time %= share.length_s;
  else [state.time, state.playing] = [share.length_s, false];
}

// ---------------------------------------------------------------- controls

/** What is chosen by what there is: colours of which the results know something. */
function offer() {
  byId("colours").querySelector(".chips").replaceChildren();
  chips("colours", "radio", offered().map((n) => [n, share.colours[n]]), (n) => n === state.colouring, chooseColouring);
  byId("lines-row").hidden = !(share.speed_max > 0);
  byId("subtitle").textContent = share.subtitle;
  byId("credit").textContent = share.credit;
  for (const button of presetButtons()) button.hidden = !offered().includes(PRESETS[button.value].colouring);
  byId("presets").hidden = offered().length < 2;
}

const presetButtons = () => byId("presets").querySelectorAll("button");

/** Round buttons of which one (radio) or any number (checkbox) is chosen. names: [value, text, title]. */
function chips(field, kind, names, chosen, choose) {
  const box = byId(field).querySelector(".chips");
  names.forEach(([value, text, title = text]) => {
    const label = document.createElement("label");
    const input = Object.assign(document.createElement("input"), { type: kind, name: field, value });
    const span = Object.assign(document.createElement("span"), { textContent: text, title });
    input.checked = chosen(value);
    input.addEventListener("change", () => choose(value, input.checked));
    label.append(input, span);
    box.append(label);
  });
  byId(field).hidden = names.length < 2;
}

function check(field, chosen) {
  for (const input of byId(field).querySelectorAll("input")) input.checked = chosen(Number(input.value));
}

/** The filmed picture first, then the results in their order. */
function panes() {
  return [...state.panes].sort((a, b) => (a === RECORDED ? -1 : b === RECORDED ? 1 : a - b));
}

/** All results and what was filmed, where there is room; on a phone two results at most, or one with a wipe. */
function usualPanes() {
  const narrow = window.matchMedia(NARROW).matches;
  const results = share.results.map((_, i) => i).slice(0, narrow ? 2 : 4);
  return narrow || !hasFrames ? results : [...results, RECORDED];
}

function usualWipe() {
  return window.matchMedia(NARROW).matches && hasFrames && share.results.length === 1 ? 0.5 : null;
}

function chooseCamera(number) {
  if (!share.cameras[number]) return;
  state.camera = number;
  state.view = homeView();
  change();
}

function choosePane(number, on) {
  if (number === WIPE) return chooseWipe(on);
  state.wipe = null;
  if (on) state.panes.add(number);
  else if (state.panes.size > 1) state.panes.delete(number);
  change();
}

/** One pane, filmed to the left and the first result shown to the right; from another view, back in the camera's. */
function chooseWipe(on) {
  state.wipe = on ? state.wipe ?? 0.5 : null;
  if (on) {
    state.panes = new Set([panes().find((number) => number !== RECORDED) ?? 0]);
    if (!atCamera()) state.view = homeView();
  }
  change();
}

/** Move the wipe's divider to a share of the picture, from its left. */
function wipeTo(part) {
  state.wipe = Math.max(0, Math.min(1, part));
  change(true);
}

function choosePreset(name) {
  Object.assign(state, PRESETS[name]);
  change();
}

function chooseColouring(number) {
  state.colouring = number;
  change();
}

function play(on) {
  if (on && state.time >= share.length_s) state.time = 0;
  state.playing = on && share.length_s > 0;
  change();
}

function step(direction) {
  const times = share.frame_s.length > 1 ? share.frame_s : Array.from({ length: 101 }, (_, i) => (i * share.length_s) / 100);
  const beyond = times.filter((t) => (t - state.time) * direction > 1e-6);
  state.time = beyond.length ? (direction > 0 ? beyond[0] : beyond.at(-1)) : state.time;
  play(false);
}

const milliseconds = (s) => (1e3 * s).toFixed(1);
const offered = () => [COLOUR, SPEED, UNCERTAINTY].filter((n) => n === COLOUR || (n === SPEED ? share.speed_max : share.uncertainty_max) > 0);

/** Bring the controls in line with the state. */
function show() {
  const slider = byId("time");
  const share1000 = share.length_s ? (1e3 * state.time) / share.length_s : 0;
  slider.value = share1000;
  slider.style.setProperty("--done", `${share1000 / 10}%`);
  const frame = frameAt(state.time);
  const frames = share.frame_s.length ? `frame ${frame + 1} of ${share.frame_s.length}` : "";
  slider.setAttribute("aria-valuetext", `${milliseconds(state.time)} milliseconds ${frames}`);
  const small = Object.assign(document.createElement("small"), { textContent: frames });
  byId("now").replaceChildren(`${milliseconds(state.time)} ms`, small);
  const button = byId("play");
  button.classList.toggle("playing", state.playing);
  button.setAttribute("aria-label", state.playing ? "Pause" : "Play");
  const here = atCamera();
  check("cameras", (value) => here && value === state.camera);
  check("colours", (value) => value === state.colouring);
  const wipe = wiping();
  check("panes", (value) => (value === WIPE ? wipe : state.panes.has(value)));
  for (const button of presetButtons()) {
    const shows = Object.entries(PRESETS[button.value]).every(([key, value]) => state[key] === value);
    button.setAttribute("aria-pressed", shows);
  }
  if (wipe) {
    const percent = Math.round(100 * state.wipe);
    byId("wipe").setAttribute("aria-valuenow", percent);
    byId("wipe").setAttribute("aria-valuetext", `${percent} % filmed, ${100 - percent} % reconstructed`);
  }
  byId("lines").checked = state.lines;
  byId("plate").checked = state.plate;
  byId("loop").setAttribute("aria-pressed", state.loop);
  byId("slow").value = state.slow;
  const size = byId("size");
  size.value = Math.round(100 * state.size);
  size.style.setProperty("--done", `${(100 * (size.value - size.min)) / (size.max - size.min)}%`);
  byId("size-text").textContent = `${size.value} %`;
  byId("reset").disabled = here;
  showScale();
  if (byId("about").open) showFacts();
}

/** The legend in m/s of whatever is coloured by a velocity. */
function showScale() {
  const uncertainty = state.colouring === UNCERTAINTY;
  const visible = state.colouring !== COLOUR || state.lines;
  byId("scale").hidden = !visible;
  const says = `${uncertainty} ${visible} ${state.colouring} ${state.lines} ${share.speed_max} ${share.uncertainty_max}`;
  if (!visible || byId("scale").dataset.says === says) return;
  byId("scale").dataset.says = says;
  const largest = uncertainty ? share.uncertainty_max : share.speed_max;
  const stops = Array.from({ length: 17 }, (_, i) => share.scheme.slice(3 * Math.min(255, 16 * i)).slice(0, 3));
  byId("scale-bar").style.background = `linear-gradient(90deg, ${stops.map((rgb) => `rgb(${rgb})`).join(", ")})`;
  byId("scale-bar").setAttribute("aria-label", `Colours from 0 to ${largest.toPrecision(3)} metres per second and more`);
  const words = uncertainty ? share.uncertainty_ticks : share.speed_ticks;
  const ticks = words.map((textContent) => Object.assign(document.createElement("span"), { textContent }));
  byId("scale-ticks").replaceChildren(...ticks);
  const { speed, uncertainty: unsure, line } = share.notes;
  byId("scale-note").textContent = uncertainty ? unsure : state.lines ? `${speed} ${line}` : speed;
}

function showFacts() {
  const now = [
    ["drawn now", `${measured.shown.toLocaleString("en")} Gaussians`],
    ["sorting", `${measured.sort.toFixed(1)} ms, off the main thread`],
    ["frames", measured.interval ? `${(1e3 / measured.interval).toFixed(0)} a second while moving, at ${100 * QUALITIES[quality]} % of the pixels a side` : "not measured yet"],
    ["blending", drawer.exact ? "16-bit floats" : "8 bits: this device has no float pictures; colours are approximate"],
  ];
  const list = byId("facts");
  list.replaceChildren();
  for (const [term, text] of [...share.facts, ...now]) {
    list.append(Object.assign(document.createElement("dt"), { textContent: term }));
    list.append(Object.assign(document.createElement("dd"), { textContent: text }));
  }
}

let silence;

function say(text) {
  const said = byId("said");
  said.textContent = text;
  said.classList.add("shown");
  clearTimeout(silence);
  silence = setTimeout(() => said.classList.remove("shown"), 2000);
}

function fail(error) {
  byId("failure").textContent = error.message;
  byId("failure").hidden = false;
}

// ---------------------------------------------------------------- hands

async function savePicture() {
  await paint(1);
  byId("canvas").toBlob((blob) => {
    const address = URL.createObjectURL(blob);
    Object.assign(document.createElement("a"), { href: address, download: `${share.file}-${milliseconds(state.time)}ms.png` }).click();
    setTimeout(() => URL.revokeObjectURL(address), 1000);
  });
}

function listen() {
  const canvas = byId("canvas");
  const fingers = new Map();
  const turn = (dx, dy) => {
    state.view = orbited(state.view, -dx, dy);
    change(true);
  };
  const move = (dx, dy) => {
    const { camera } = state.view;
    const scale = lensIn(camera, canvas.clientWidth, canvas.clientHeight, enlarged(1)).focal[0] / reach(state.view);
    state.view = panned(state.view, -dx / scale / reach(state.view), -dy / scale / reach(state.view));
    change(true);
  };
  const zoom = (factor) => {
    state.view = dollied(state.view, factor, reach(homeView()));
    change(true);
  };
  const middle = () => {
    const all = [...fingers.values()];
    const mean = [0, 1].map((k) => all.reduce((sum, p) => sum + p[k], 0) / all.length);
    return [...mean, all.length > 1 ? Math.hypot(all[0][0] - all[1][0], all[0][1] - all[1][1]) : 0];
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    const [x0, y0, apart0] = middle();
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    const [x1, y1, apart1] = middle();
    if (fingers.size > 1) {
      move(x1 - x0, y1 - y0);
      if (apart0 > 0 && apart1 > 0) zoom(apart0 / apart1);
    } else if (event.buttons & 6 || event.shiftKey) move(x1 - x0, y1 - y0);
    else turn((x1 - x0) * 0.008, -(y1 - y0) * 0.008);
  });
  for (const over of ["pointerup", "pointercancel"])
    canvas.addEventListener(over, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(Math.max(-0.4, Math.min(0.4, event.deltaY * (event.deltaMode ? 0.05 : 0.0015)))));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (way && event.shiftKey) move(-40 * way[0], -40 * way[1]);
    else if (way) turn(-0.09 * way[0], 0.09 * way[1]);
    else if (event.key === "+" || event.key === "=") zoom(0.9);
    else if (event.key === "-") zoom(1 / 0.9);
    else return;
    event.preventDefault();
  });
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => {
    drawer = new Drawer(canvas, shaders, clouds, share.scheme);
    change();
  });
  new ResizeObserver(() => change()).observe(canvas);

  byId("time").addEventListener("input", (event) => {
    state.time = (event.target.value / 1e3) * share.length_s;
    state.playing = false;
    change(true);
  });
  byId("play").addEventListener("click", () => play(!state.playing));
  byId("slow").addEventListener("change", (event) => ((state.slow = Number(event.target.value)), change()));
  byId("loop").addEventListener("click", () => ((state.loop = !state.loop), change()));
  byId("lines").addEventListener("change", (event) => ((state.lines = event.target.checked), change()));
  byId("plate").addEventListener("change", (event) => ((state.plate = event.target.checked), change()));
  byId("size").addEventListener("input", (event) => ((state.size = event.target.value / 100), change(true)));
  for (const button of presetButtons()) button.addEventListener("click", () => choosePreset(button.value));
  byId("copy").addEventListener("click", copyLink);
  byId("embed")?.addEventListener("click", copyEmbedding);
  byId("save").addEventListener("click", savePicture);
  byId("reset").addEventListener("click", () => chooseCamera(state.camera));
  byId("about").addEventListener("toggle", showFacts);
  byId("more").addEventListener("click", () => {
    const open = document.body.classList.toggle("open");
    byId("more").setAttribute("aria-expanded", open);
    byId("more").textContent = open ? "Close" : "Controls";
  });
  window.addEventListener("hashchange", () => {
    if (fromHash(location.hash)) state.playing = false;
    change();
  });
  window.addEventListener("keydown", pressed);
  listenToDivider();
}

function listenToDivider() {
  const divider = byId("wipe");
  divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
  divider.addEventListener("pointermove", (event) => {
    if (!divider.hasPointerCapture(event.pointerId)) return;
    const canvas = byId("canvas");
    const [left, , width] = lensIn(share.cameras[state.camera], canvas.clientWidth, canvas.clientHeight, enlarged(1)).picture;
    wipeTo((event.clientX - canvas.getBoundingClientRect().left - left) / width);
  });
  divider.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -0.02, ArrowDown: -0.02, ArrowRight: 0.02, ArrowUp: 0.02, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1 }[event.key];
    if (!step) return;
    wipeTo(state.wipe + step);
    event.preventDefault();
  });
}

function closePanel() {
  if (document.body.classList.contains("open")) byId("more").click();
}

function pressed(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const types = event.target.closest?.("select, summary, button, input:not([type=range])");
  if (types && (event.key === " " || event.key === "Enter")) return; // they have a use for it themselves
  const all = offered();
  const keys = {
    " ": () => play(!state.playing),
    ",": () => step(-1),
    ".": () => step(1),
    c: () => chooseColouring(all[(all.indexOf(state.colouring) + 1) % all.length]),
    v: () => share.speed_max > 0 && (state.lines = !state.lines),
    b: () => (state.plate = !state.plate),
    0: () => chooseCamera(state.camera),
    Escape: closePanel,
  };
  if (/^[1-9]$/.test(event.key)) chooseCamera(Number(event.key) - 1);
  else if (keys[event.key]) keys[event.key]();
  else return;
  event.preventDefault();
  change();
}

// ---------------------------------------------------------------- begin

/** What a script may ask of the page: the picture of the state as a data: URL, and ms a frame, drawn to the end. */
const player = {
  state, measured, toHash,
  async picture() {
    await paint(1);
    return byId("canvas").toDataURL();
  },
  async time(frames) {
    await paint(1);
    drawer.finish();
    const began = performance.now();
    for (let i = 0; i < frames; i++) {
      state.time = (share.length_s * i) / frames;
      await paint(1);
      drawer.finish();
    }
    return (performance.now() - began) / frames;
  },
};

function begin() {
  drawer = new Drawer(byId("canvas"), shaders, clouds, share.scheme);
  sorted = startSorter();
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  const linked = location.hash.length > 1;
  if (!fromHash(location.hash) && !still) state.playing = share.length_s > 0;
  chips("cameras", "radio", share.cameras.map(({ name }, i) => [i, cameraLabel(i), name]), () => false, chooseCamera);
  const recorded = hasFrames || hasTruth ? [[RECORDED, "Filmed"]] : [];
  const wipe = hasFrames ? [[WIPE, "Wipe", "Filmed and reconstructed in one picture, with a line to drag"]] : [];
  const results = share.results.map(({ name }, i) => [i, resultLabel(i), name]);
  chips("panes", "checkbox", [...recorded, ...results, ...wipe], () => false, choosePane);
  offer();
  byId("plate-row").hidden = !share.cameras.some((camera) => camera.plate);
  listen();
  show();
  loop(() => greet(still || linked));
  if (share.live) follow();
}

window.player = player;
try {
  begin();
} catch (error) {
  fail(error);
}
