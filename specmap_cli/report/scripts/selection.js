// The chosen submap: on the map, in the panel, in the table, and in the address of the page.

const regions = new Map(all(".region").map((region) => [region.dataset.submap, region]));
const tip = one("#tip");
let chosen = null;
let reached = null; // the submap that the keyboard stands on

const partsOf = (id) => all(`[data-submap="${id}"]`).filter((part) => !part.matches("a, rect"));

function choose(id, { move = true, focus = false } = {}) {
  if (!regions.has(id)) return;
  if (chosen !== null) mark(chosen, false);
  chosen = reached = id;
  mark(id, true);
  one("#no-sheet").hidden = true;
  one("#panel").scrollTop = 0;
  for (const bar of all(".strip rect")) bar.classList.toggle("dull", bar.dataset.submap !== id);
  if (move && !isSeen(numbers(regions.get(id).dataset.at))) goTo(numbers(regions.get(id).dataset.box), 0.6);
  writeAddress(`#submap-${id}`);
  say(`${data.names[id]} is chosen`);
  if (focus) one(`#sheet-${id}`).focus({ preventScroll: true });
}

function mark(id, isChosen) {
  for (const part of partsOf(id)) part.classList.toggle("chosen", isChosen);
  regions.get(id).setAttribute("aria-pressed", isChosen);
  one("#outline").setAttribute("d", isChosen ? one(".rim", regions.get(id)).getAttribute("d") : "");
}

function writeAddress(hash) {
  try {
    history.replaceState(null, "", hash);
  } catch {
    // a page shown inside another one may not change its address
  }
}

function chooseNone() {
  if (chosen === null) return;
  mark(chosen, false);
  chosen = null;
  one("#no-sheet").hidden = false;
  for (const bar of all(".strip rect")) bar.classList.remove("dull");
  writeAddress("#");
}

document.addEventListener("click", (event) => {
  const link = event.target.closest("a[data-submap]");
  const row = event.target.closest("tr[data-submap]");
  const close = event.target.closest("[data-close]");
  const place = event.target.closest("#map [data-submap]");
  if (close) {
    event.preventDefault();
    chooseNone();
    map.focus({ preventScroll: true });
  } else if (link) {
    event.preventDefault();
    choose(link.dataset.submap, { focus: true });
    stage.scrollIntoView({ block: "nearest" });
  } else if (row) choose(row.dataset.submap);
  else if (place) choose(place.dataset.submap, { move: false });
});

// Hovering marks a submap everywhere.
for (const kind of ["pointerover", "pointerout"]) {
  document.addEventListener(kind, (event) => {
    const part = event.target.closest?.("tr[data-submap], #map [data-submap], a[data-submap]");
    if (!part) return;
    for (const other of partsOf(part.dataset.submap)) other.classList.toggle("near", kind === "pointerover");
  });
}

map.addEventListener("pointermove", (event) => {
  const part = event.target.closest("[data-tip], [data-submap]");
  tip.hidden = !part || held.size > 0 || event.pointerType === "touch";
  if (tip.hidden) return;
  tip.textContent = part.dataset.tip ?? tipOf(part.dataset.submap);
  const { left, top, width } = stage.getBoundingClientRect();
  const x = Math.min(event.clientX - left + 14, width - tip.offsetWidth - 8);
  tip.style.left = `${Math.max(8, x)}px`;
  tip.style.top = `${event.clientY - top + 18}px`;
});
map.addEventListener("pointerleave", () => { tip.hidden = true; });

function tipOf(id) {
  const sheet = one(`#sheet-${id}`);
  const words = [data.names[id], one(".kind", sheet).textContent, one(".figures dd", sheet)?.textContent];
  return words.filter(Boolean).join(" · ");
}

// The keyboard: arrows go to the nearest submap in their direction, Enter chooses it.
const WAYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

function nextTo(id, [ahead, down]) {
  const [x, y] = numbers(regions.get(id).dataset.at);
  let best = null, least = Infinity;
  for (const [other, region] of regions) {
    const [u, v] = numbers(region.dataset.at);
    const along = (u - x) * ahead + (v - y) * down, aside = Math.abs((u - x) * down + (v - y) * ahead);
    const cost = Math.hypot(along, 2 * aside);
    if (along > 0 && along > aside / 2 && cost < least) [best, least] = [other, cost];
  }
  return best;
}

function reach(id) {
  if (reached !== null) regions.get(reached)?.setAttribute("tabindex", -1);
  reached = id;
  const region = regions.get(id);
  region.setAttribute("tabindex", 0);
  region.focus({ preventScroll: true });
  if (!isSeen(numbers(region.dataset.at))) goTo(numbers(region.dataset.box), 0.6);
  say(tipOf(id));
}

map.addEventListener("keydown", (event) => {
  const onRegion = event.target.closest(".region");
  if (WAYS[event.key] && !event.shiftKey) {
    const from = onRegion?.dataset.submap ?? null;
    const to = from === null ? reached ?? regions.keys().next().value : nextTo(from, WAYS[event.key]);
    if (to !== null && to !== undefined) reach(to);
  } else if ((event.key === "Enter" || event.key === " ") && onRegion) choose(onRegion.dataset.submap, { move: false });
  else if (event.key === "Escape") {
    chooseNone();
    map.focus({ preventScroll: true });
  } else return;
  event.preventDefault();
});

function fromAddress() {
  const found = location.hash.match(/^#(?:submap|sheet)-(\d+)$/);
  if (found) choose(found[1]);
}
addEventListener("hashchange", fromAddress);
fromAddress();
