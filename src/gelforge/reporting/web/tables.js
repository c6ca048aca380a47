"use strict";
// Copying tables, for every page.
function copyText(text, button) {
  const said = button.textContent;
  const done = () => { button.textContent = "Copied"; setTimeout(() => { button.textContent = said; }, 1200); };
  const byHand = () => {
    const area = document.createElement("textarea");
    area.value = text; document.body.append(area); area.select(); document.execCommand("copy"); area.remove(); done();
  };
  if (navigator.clipboard) navigator.clipboard.writeText(text).then(done, byHand); else byHand();
}
function csvCell(value) {
  const text = value === null || value === undefined || Number.isNaN(value) ? "" : String(value);
  return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}
const csvText = (rows) => rows.map((row) => row.map(csvCell).join(",")).join("\n") + "\n";
function copyButton(rows) {
  const button = document.createElement("button");
  button.textContent = "Copy as CSV";
  button.onclick = () => copyText(csvText(rows()), button);
  return button;
}
for (const table of document.querySelectorAll(".scroll table")) {
  const rows = () => [...table.rows].map((row) => [...row.cells].map((cell) => cell.textContent));
  table.parentElement.after(copyButton(rows));
}
