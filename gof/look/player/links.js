"use strict";

// The page's state as an address, and what is copied for others.

/** View, time and what is shown, as it stands behind the # of the page's address. */
function toHash() {
  const said = new URLSearchParams({ t: milliseconds(state.time), cam: share.cameras[state.camera].name });
  if (!atCamera()) said.set("view", viewToText(state.view));
  if (state.colouring) said.set("colour", COLOURINGS[state.colouring]);
  if (state.lines) said.set("lines", 1);
  if (!state.plate) said.set("plate", 0);
  if (state.size !== 1) said.set("size", state.size);
  if (state.slow !== 10) said.set("slow", state.slow);
  if (state.wipe !== null) said.set("wipe", Math.round(100 * state.wipe));
  said.set("show", panes().map((n) => (n === RECORDED ? "recorded" : n)).join(" "));
  return said.toString();
}

/**
 * Whether the address said a time. What it does not say, or says and cannot be, is as on a page just opened: a link means
 * the same whatever was shown before.
 */
function fromHash(hash) {
  const said = new URLSearchParams(hash.replace(/^#/, ""));
  const number = (key, low, high) => {
    const value = said.has(key) ? Number(said.get(key)) : NaN;
    return Number.isFinite(value) ? Math.min(high, Math.max(low, value)) : null;
  };
  const camera = share.cameras.findIndex(({ name }) => name === said.get("cam"));
  state.camera = camera >= 0 ? camera : share.start;
  state.view = (said.has("view") && viewFromText(said.get("view"), share.cameras[state.camera])) || homeView();
  const time = number("t", 0, 1e3 * share.length_s);
  if (time !== null) state.time = time / 1e3;
  const named = said.get("colour") === "doubt" ? "uncertainty" : said.get("colour"); // links of 0.2
  const colouring = COLOURINGS.indexOf(named);
  state.colouring = offered().includes(colouring) ? colouring : COLOUR;
  state.lines = said.get("lines") === "1";
  state.plate = said.get("plate") !== "0";
  state.size = number("size", 0.05, 1.5) ?? 1;
  state.slow = [1, 2, 5, 10, 20, 50, 100].includes(number("slow", 1, 100)) ? number("slow", 1, 100) : 10;
  const wanted = (said.get("show") ?? "").split(" ").map((name) => (name === "recorded" ? RECORDED : parseInt(name, 10)));
  const found = wanted.filter((n) => (n === RECORDED ? hasFrames || hasTruth : share.results[n]));
  state.panes = new Set(found.length ? found : usualPanes());
  const bare = said.get("bare") === "1";
  const wipe = hasFrames && !found.includes(RECORDED) ? number("wipe", 0, 100) : null;
  state.wipe = wipe !== null ? wipe / 100 : found.length || bare ? null : usualWipe();
  document.body.classList.toggle("bare", bare);
  if (said.get("play") === "1") state.playing = true;
  return time !== null;
}

async function copyLink() {
  const link = `${location.href.split("#")[0]}#${toHash()}`;
  history.replaceState(null, "", `#${toHash()}`);
  say((await copied(link)) ? "Link copied: this view, this time" : "The link is in the address bar");
}

/** HTML that shows this file in another page. From the disk it names the file alone: no folder of its owner's. */
function embedding() {
  const address = location.protocol === "file:" ? location.pathname.split("/").at(-1) : location.href.split("#")[0];
  const quoted = (text) => `"${text.replace(/[&"<>]/g, (c) => `&#${c.charCodeAt(0)};`)}"`;
  const said = { src: address, title: document.title, width: "100%", height: "640", style: "border:0", allow: "clipboard-write" };
  return `<iframe ${Object.entries(said).map(([key, value]) => `${key}=${quoted(value)}`).join(" ")}></iframe>`;
}

async function copyEmbedding() {
  say((await copied(embedding())) ? "HTML copied: it shows this file in a page of yours" : "This browser does not let the page copy");
}

/** Whether the text is on the clipboard. */
async function copied(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    const area = Object.assign(document.createElement("textarea"), { value: text });
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    return done;
  }
}
