// Rows are shown whose name holds what is sought, and whose result is the one wanted.
{
  const rows = all("#jobs tbody tr"), sought = one("#sought"), wanted = one("#wanted");
  const show = () => {
    const words = sought.value.toLowerCase().split(/\s+/).filter(Boolean), result = wanted.value;
    let count = 0;
    for (const row of rows) {
      const fits = words.every((word) => row.dataset.name.includes(word)) && (!result || row.dataset.result === result);
      row.hidden = !fits;
      count += fits;
    }
    one("#shown").textContent = count === rows.length ? "" : `${count} of ${rows.length} jobs`;
  };
  sought.addEventListener("input", show);
  wanted.addEventListener("change", show);
  one("#search").addEventListener("submit", (event) => event.preventDefault());
  show();
}
