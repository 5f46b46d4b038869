// The split tests: a dot each; the chosen one shows its spectrum, and its nodes on the map.

const chart = one("#tests");
let test = null;

function chooseTest(index) {
  const found = data.tests[index];
  if (!found) return;
  one(`#test-${test}`)?.setAttribute("aria-selected", false);
  test = index;
  const dot = one(`#test-${index}`);
  dot.setAttribute("aria-selected", true);
  chart.setAttribute("aria-activedescendant", dot.id);
  one("#test-shown").hidden = false;
  drawSpectrum(found);
  if (nodesShown()) drawNodes(found.nodes);
  one("#test-words").textContent = wordsOf(found);
}

function wordsOf(found) {
  const at = `${clock(found.t)}: `;
  if (!found.chosen) return `${at}no eigenvector divides the way: one region.`;
  const value = found.values[found.chosen].toFixed(3);
  const above = found.values[found.chosen] > data.threshold;
  const outcome = above ? "but a part would be too short to stand alone: one region." : "one region.";
  const against = found.split ? `above ${data.threshold}: split.` : outcome;
  return `${at}eigenvalue ${found.chosen + 1} of the graph divides the way; it is ${value}, ${against}`;
}

function drawSpectrum(found) {
  const bars = found.values.map((value, number) => {
    const bar = document.createElement("i");
    bar.style.height = `${Math.max(0, Math.min(1, value)) * 100}%`;
    bar.classList.toggle("taken", found.chosen > 0 && number === found.chosen);
    return bar;
  });
  const line = document.createElement("b");
  line.style.bottom = `${data.threshold * 100}%`;
  one("#spectrum").replaceChildren(...bars, line);
}

const nodesShown = () => one("#test-nodes").childElementCount > 0;

function drawNodes(nodes) {
  const marks = [];
  for (let k = 0; k < nodes.length; k += 3) {
    const [x, y, side] = nodes.slice(k, k + 3);
    const shade = 0.4 + (0.6 * Math.abs(side)) / 9;
    marks.push(svg("circle", { cx: x, cy: y, r: 11, class: side >= 0 ? "near-side" : "far-side", opacity: shade.toFixed(2) }));
  }
  one("#test-nodes").replaceChildren(...marks);
}

function boxOf(found) {
  const xs = found.nodes.filter((_, k) => k % 3 === 0), ys = found.nodes.filter((_, k) => k % 3 === 1);
  const [left, top] = [Math.min(...xs), Math.min(...ys)];
  return [left, top, Math.max(...xs) - left, Math.max(...ys) - top];
}

chart?.addEventListener("click", (event) => {
  const dot = event.target.closest(".dot");
  if (dot) chooseTest(Number(dot.dataset.test));
});

chart?.addEventListener("keydown", (event) => {
  const last = data.tests.length - 1;
  const to = { ArrowRight: (test ?? -1) + 1, ArrowLeft: (test ?? 1) - 1, Home: 0, End: last }[event.key];
  if (to === undefined) return;
  event.preventDefault();
  chooseTest(Math.min(last, Math.max(0, to)));
});

one("#test-on-map")?.addEventListener("click", (event) => {
  const found = data.tests[test], shown = !nodesShown();
  drawNodes(shown ? found.nodes : []);
  event.target.setAttribute("aria-pressed", shown);
  event.target.textContent = shown ? "hide on the map" : "show on the map";
  if (!shown) return;
  seek(found.t);
  if (found.nodes.length) goTo(boxOf(found), 0.3);
  stage.scrollIntoView({ block: "nearest" });
});

if (chart) chooseTest(Math.max(0, data.tests.findIndex((found) => found.split)));
