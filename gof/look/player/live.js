"use strict";

// Only on the page of `gof view`: its requests to the program that serves it.

const LOOK_MS = 1000; // between two looks for a newer result

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** Take over what a newer result, or another instant of the same one, has in place of the old. The view stays. */
function adopt(news) {
  Object.assign(share, news);
  clouds = unpacked(share.results);
  drawer.replace(clouds);
  giveSorter();
}

/** Show a newer result as soon as there is one: a reconstruction that runs writes one now and then. */
async function follow() {
  let there = true;
  for (;;) {
    await pause(LOOK_MS);
    try {
      const answer = await fetch(`news?have=${encodeURIComponent(share.stamp)}`);
      if (answer.status === 200) {
        adopt(await answer.json());
        if (!offered().includes(state.colouring)) state.colouring = COLOUR;
        offer();
        change();
      }
      if (!there) say("gof view is there again");
      there = true;
    } catch {
      if (there) say("gof view has ended: this page shows what it had");
      there = false;
    }
  }
}

/** Of a result that is sampled in time: have its Gaussians of the time that is shown. */
async function goToInstant() {
  const { time } = state;
  if (share.instant === time) return;
  try {
    const answer = await fetch(`instant?time=${time}`);
    if (answer.status === 200) adopt({ ...(await answer.json()), instant: time });
  } catch {
    share.instant = time; // the program has ended: what was there stays
  }
}
