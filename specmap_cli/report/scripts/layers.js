// Layers are shown and hidden; the trajectory has two ways to be coloured.

for (const box of all("[data-shows]")) {
  box.addEventListener("change", () => showLayer(box.dataset.shows, box.checked));
}

function showLayer(name, shown) {
  const box = one(`[data-shows="${name}"]`);
  if (box) box.checked = shown;
  for (const layer of all(`[data-layer="${name}"]`)) layer.classList.toggle("off", !shown);
  if (name === "regions") one("#regions").classList.toggle("plain-ground", !shown);
}

one("#colours")?.addEventListener("change", (event) => {
  for (const part of all("[data-colours]")) {
    part.classList.toggle("off", part.dataset.colours !== event.target.value);
  }
  showLayer("track", true);
});
