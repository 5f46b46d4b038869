// Which part of the map is seen: `view` in centimetres of the drawing.

const view = { x: 0, y: 0, width: data.width, height: data.height };
const LARGEST = 80; // times the whole map
const SETTLE_MS = 90; // after the last motion the map is drawn anew; until then its picture moves
let stillFits = true;
let drawn = null; // the view that the map was last drawn for
let settling = null;

function frameOf(box, margin = 0.04) {
  // the smallest view of the stage's proportions that shows a box [x, y, width, height]
  const { width, height } = stage.getBoundingClientRect();
  const [x, y, w, h] = box;
  const seen = Math.max(w * (1 + 2 * margin), (h * (1 + 2 * margin) * width) / height);
  const tall = (seen * height) / width;
  return { x: x + w / 2 - seen / 2, y: y + h / 2 - tall / 2, width: seen, height: tall };
}

function wholeView() {
  return frameOf([0, 0, data.width, data.height], 0.015);
}

function look(at) {
  const whole = wholeView();
  const width = Math.min(Math.max(at.width, whole.width / LARGEST), whole.width);
  const height = (width * whole.height) / whole.width;
  const centre = [at.x + at.width / 2, at.y + at.height / 2];
  // the middle of the screen stays on the map
  const x = Math.min(Math.max(centre[0], 0), data.width) - width / 2;
  const y = Math.min(Math.max(centre[1], 0), data.height) - height / 2;
  stillFits = width > whole.width * 0.999;
  Object.assign(view, stillFits ? whole : { x, y, width, height });
  paint();
}

function paint() {
  map.classList.toggle("zoomed", !stillFits);
  drawScale(view.width / stage.clientWidth);
  clearTimeout(settling);
  if (!drawn) return redraw();
  // a large map takes long to draw: while it moves, the picture that is there is moved
  const perPixel = view.width / stage.clientWidth, scale = drawn.width / view.width;
  const x = (drawn.x - view.x) / perPixel, y = (drawn.y - view.y) / perPixel;
  map.style.willChange = "transform";
  map.style.transform = `translate(${x}px, ${y}px) scale(${scale})`;
  settling = setTimeout(redraw, SETTLE_MS);
}

function redraw() {
  drawn = { ...view };
  map.style.transform = map.style.willChange = "";
  map.setAttribute("viewBox", `${view.x} ${view.y} ${view.width} ${view.height}`);
  map.style.setProperty("--px", (view.width / stage.clientWidth) * badgeScale());
  map.classList.toggle("crowded", badgeScale() < 0.7);
  uncover();
}

function uncover() {
  // of names that would lie on another name or number the first alone is shown
  const taken = all(".badge circle", map).map((circle) => [circle.parentNode, circle.getBoundingClientRect()]);
  for (const name of all(".badge .name", map)) {
    const own = name.getBoundingClientRect();
    const meets = ([badge, box]) => badge !== name.parentNode && own.left < box.right && box.left < own.right && own.top < box.bottom && box.top < own.bottom;
    const covered = taken.some(meets);
    name.classList.toggle("covered", covered);
    if (!covered) taken.push([name.parentNode, own]);
  }
}

function badgeScale() {
  // many rooms on a small screen: smaller badges, down to a half
  const rooms = Math.max(1, Object.keys(data.names).length);
  const side = Math.sqrt((data.width * data.height) / rooms) * (stage.clientWidth / view.width);
  return Math.min(1, Math.max(0.45, side / 80));
}

function drawScale(perPixel) {
  const most = 120 * perPixel / 100; // metres
  const power = 10 ** Math.floor(Math.log10(most));
  const length = power * [5, 2, 1].find((step) => step * power <= most);
  const scale = one("#scale");
  scale.lastChild.nodeType === Node.TEXT_NODE && scale.lastChild.remove();
  scale.append(length < 1 ? `${Math.round(length * 100)} cm` : `${length} m`);
  one("span", scale).style.width = `${(length * 100) / perPixel}px`;
}

function pointOf(event) {
  const { left, top, width, height } = stage.getBoundingClientRect();
  return [view.x + ((event.clientX - left) / width) * view.width, view.y + ((event.clientY - top) / height) * view.height];
}

function zoomBy(factor, around = [view.x + view.width / 2, view.y + view.height / 2]) {
  const [x, y] = around;
  const width = Math.min(view.width / factor, wholeView().width), share = width / view.width;
  look({ x: x - (x - view.x) * share, y: y - (y - view.y) * share, width, height: view.height * share });
}

function panBy(x, y) {
  look({ ...view, x: view.x + x, y: view.y + y });
}

function goTo(box, margin) {
  const from = { ...view }, to = frameOf(box, margin);
  if (calm()) return look(to);
  const start = performance.now();
  const step = (now) => {
    const share = Math.min(1, (now - start) / 350), eased = 1 - (1 - share) ** 3;
    const mixed = {};
    for (const key of ["x", "y", "width", "height"]) mixed[key] = from[key] + (to[key] - from[key]) * eased;
    look(mixed);
    if (share < 1) requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
}

function showPlace([x, y]) {
  // a place with some metres round it; what is larger on the screen already stays as it is
  const reach = Math.min(500, view.width / 2);
  goTo([x - reach, y - reach, 2 * reach, 2 * reach], 0);
  stage.scrollIntoView({ block: "nearest" });
}

function isSeen([x, y]) {
  return x > view.x && x < view.x + view.width && y > view.y && y < view.y + view.height;
}

const fit = () => look(wholeView());

// Fingers and the mouse. A click is a press that did not move.
const held = new Map();
let moved = false;

map.addEventListener("pointerdown", (event) => {
  held.set(event.pointerId, [event.clientX, event.clientY]);
  if (held.size === 1) moved = false;
});

map.addEventListener("pointermove", (event) => {
  const before = held.get(event.pointerId);
  if (!before) return;
  const now = [event.clientX, event.clientY];
  const far = Math.hypot(now[0] - before[0], now[1] - before[1]);
  if (!moved && far < 4) return;
  if (!moved) map.setPointerCapture(event.pointerId);
  moved = true;
  map.classList.add("held");
  const perPixel = view.width / stage.clientWidth;
  const others = [...held].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
  held.set(event.pointerId, now);
  if (others.length) {
    const span = (at) => Math.max(1, Math.hypot(at[0] - others[0][0], at[1] - others[0][1]));
    const middle = { clientX: (now[0] + others[0][0]) / 2, clientY: (now[1] + others[0][1]) / 2 };
    zoomBy(span(now) / span(before), pointOf(middle));
  }
  const share = others.length ? 0.5 : 1;
  panBy((before[0] - now[0]) * perPixel * share, (before[1] - now[1]) * perPixel * share);
});

for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) {
  map.addEventListener(kind, (event) => {
    held.delete(event.pointerId);
    map.classList.remove("held");
  });
}

map.addEventListener("click", (event) => {
  if (moved) event.stopPropagation();
  moved = false;
}, true);

map.addEventListener("dblclick", (event) => zoomBy(2, pointOf(event)));

map.addEventListener("wheel", (event) => {
  // a plain wheel scrolls the page; with Ctrl, as of a pinch on a touchpad, it zooms
  if (!event.ctrlKey && !event.metaKey) return;
  event.preventDefault();
  zoomBy(Math.exp(-event.deltaY * 0.01), pointOf(event));
}, { passive: false });

for (const button of all("[data-zoom]")) {
  const act = { in: () => zoomBy(1.6), out: () => zoomBy(1 / 1.6), fit };
  button.addEventListener("click", act[button.dataset.zoom]);
}

map.addEventListener("keydown", (event) => {
  const step = view.width / 8;
  const keys = {
    "+": () => zoomBy(1.5), "=": () => zoomBy(1.5), "-": () => zoomBy(1 / 1.5), "0": fit,
  };
  const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
  if (event.shiftKey && moves[event.key]) panBy(...moves[event.key]);
  else if (keys[event.key] && !event.ctrlKey && !event.metaKey) keys[event.key]();
  else return;
  event.preventDefault();
  event.stopPropagation();
});

new ResizeObserver(() => {
  drawn = null;
  stillFits ? fit() : look(view);
}).observe(stage);
addEventListener("beforeprint", () => {
  clearTimeout(settling);
  map.style.transform = "";
  map.setAttribute("viewBox", `0 0 ${data.width} ${data.height}`);
  map.style.setProperty("--px", Math.max(data.width, data.height) / 700);
});
addEventListener("afterprint", redraw);
fit();
