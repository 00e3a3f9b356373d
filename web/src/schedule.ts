// One loop for everything that moves: first what decides about the frame, then, in the same picture, what draws it.

const ticks = new Set<() => void>();
const draws = new Set<() => void>();
const lasts = new Set<() => void>();
let asked = false;

/** Run once before the next picture is drawn. */
export function tickSoon(tick: () => void): void {
  ticks.add(tick);
  ask();
}

/** Draw once in the next picture, however often it is asked for. */
export function drawSoon(draw: () => void): void {
  draws.add(draw);
  ask();
}

/** Run once after the next picture was drawn. */
export function afterDrawing(last: () => void): void {
  lasts.add(last);
  ask();
}

function ask(): void {
  if (asked) return;
  asked = true;
  requestAnimationFrame(run);
}

function run(): void {
  asked = false;
  const due = [...ticks];
  ticks.clear();
  for (const tick of due) tick();
  // What listens to the changes of the ticks has its turn first (see `after` in store.ts).
  queueMicrotask(() => {
    const drawn = [...draws];
    draws.clear();
    for (const draw of drawn) draw();
    const left = [...lasts];
    lasts.clear();
    for (const last of left) last();
  });
}
