"use strict";

// The first seconds of a page: it says that one may turn it, and sways until it is touched.

const HINT_MS = 3000;
const SWAY_DEGREES = 5, SWAY_MS = 9000, GLIDE_MS = 400; // to each side; there and back; home again once something is touched
const SWAY_OF_WIPE = 0.1; // of the picture's width, to each side

const sway = { since: null, ended: null }; // ms; until something is touched, the view moves by itself

/** -1 to 1: how far to which side. */
function swayNow(now = performance.now()) {
  if (sway.since === null) return 0;
  const left = sway.ended === null ? 1 : 1 - (now - sway.ended) / GLIDE_MS;
  if (left <= 0) sway.since = null;
  return Math.max(0, left) * Math.sin((2 * Math.PI * (now - sway.since)) / SWAY_MS);
}

/** The view as it is drawn. Where the filmed picture wipes over it, its divider sways instead: the picture has one view. */
function swayed(view) {
  const side = wiping() ? 0 : swayNow();
  return side ? orbited(view, (side * SWAY_DEGREES * Math.PI) / 180, 0) : view;
}

function shownWipe() {
  return Math.max(0, Math.min(1, state.wipe + SWAY_OF_WIPE * swayNow()));
}

/** Say that one may turn it, and show so. */
function greet(still) {
  setTimeout(() => byId("hint").classList.add("gone"), HINT_MS);
  if (!still && !touched) sway.since = performance.now(); // it may have been turned before its first picture was there
  for (const kind of ["pointerdown", "keydown", "wheel", "hashchange"]) window.addEventListener(kind, settle, { capture: true, passive: true });
}

/** Something was touched: a hand takes the view where it is now, anything else lets it go home. */
function settle(event) {
  byId("hint").classList.add("gone");
  if (sway.since === null || sway.ended !== null) return;
  const taken = event.type !== "keydown" && [byId("canvas"), byId("wipe")].includes(event.target);
  if (!taken) sway.ended = performance.now();
  else {
    if (wiping()) state.wipe = shownWipe();
    else state.view = swayed(state.view);
    sway.since = null;
  }
  change();
}
