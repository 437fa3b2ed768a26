"use strict";
for (const range of document.querySelectorAll(".wipe input")) {
  const wipe = () => range.parentNode.style.setProperty("--at", `${range.value}%`);
  range.addEventListener("input", wipe);
  wipe();  // a reloaded page may remember where it stood
}
const button = document.getElementById("copy");
button?.addEventListener("click", async () => {
  const table = document.getElementById("latex");
  try {
    await navigator.clipboard.writeText(table.value);
  } catch {  // refused: show what could not be copied, marked
    table.hidden = false;
    table.select();
    if (!document.execCommand("copy")) return;
  }
  button.textContent = "Copied";
});
