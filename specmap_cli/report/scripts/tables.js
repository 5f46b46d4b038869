// A table is sorted by the column whose head is pressed; pressed again, the other way round.

function sortTable(button) {
  const head = button.closest("th"), table = head.closest("table"), body = one("tbody", table);
  const column = [...head.parentElement.children].indexOf(head);
  const down = head.getAttribute("aria-sort") === "ascending";
  const isNumber = button.dataset.sort === "number";
  const value = (row) => {
    const cell = row.children[column];
    return isNumber ? Number(cell.dataset.value) : cell.textContent.trim();
  };
  const compare = (a, b) => (isNumber ? a - b : a.localeCompare(b, undefined, { numeric: true }));
  const rows = [...body.rows].sort((a, b) => compare(value(a), value(b)) * (down ? -1 : 1));
  body.append(...rows);
  for (const other of all("th", head.parentElement)) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
}

for (const button of all("[data-sort]")) button.addEventListener("click", () => sortTable(button));
