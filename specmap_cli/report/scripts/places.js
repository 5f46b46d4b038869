// Findings, doors and changes lead to their places on the map, and marks on the map back.

function flash(part) {
  if (!part) return;
  part.classList.add("shown");
  setTimeout(() => part.classList.remove("shown"), 2000);
}

document.addEventListener("click", (event) => {
  const place = event.target.closest("button[data-at]");
  const door = event.target.closest("[data-door]");
  if (place) showPlace(numbers(place.dataset.at));
  if (place?.dataset.finding) showLayer("findings", true);
  if (place?.dataset.change) showLayer("changes", true);
  if (door) {
    const drawn = one(`#door-${door.dataset.door}`), { x, y, width, height } = drawn.getBBox();
    showLayer("doors", true);
    showPlace([x + width / 2, y + height / 2]);
    flash(drawn);
  }
});

function tellOfFinding(mark) {
  const line = one(`#finding-${mark.dataset.finding}`);
  line.scrollIntoView({ block: "center" });
  flash(line);
}

for (const mark of all(".finding")) {
  mark.addEventListener("click", () => tellOfFinding(mark));
  mark.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || event.key === " ") tellOfFinding(mark);
  });
}
