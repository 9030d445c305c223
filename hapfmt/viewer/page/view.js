// The part of the time line that is in sight: state.t0 to state.t1, within state.start to state.stop.

const EDGE = 0.02;

// The shortest view: times as doubles are still distinct.
function shortest(state) {
  return Math.max(1e-9, Math.max(Math.abs(state.start), Math.abs(state.stop)) * 1e-12);
}

// The widest view: the time line with some room at its ends.
export function widest({ start, stop }) {
  const edge = (stop - start) * EDGE;
  return [start - edge, stop + edge];
}

export function showAll(state) {
  setView(state, ...widest(state));
}

export function setView(state, t0, t1) {
  const whole = (state.stop - state.start) * (1 + 2 * EDGE);
  const span = Math.min(whole, Math.max(shortest(state), t1 - t0));
  if (!Number.isFinite(span)) return;
  const low = state.start - Math.max((state.stop - state.start) * EDGE, Math.min(span * 0.5, whole - span));
  const high = state.stop + (state.start - low) - span;
  const from = (t0 + t1 - span) / 2;
  const start = Math.min(Math.max(from, low), Math.max(high, low));
  state.set({ t0: start, t1: start + span });
}

export function zoom(state, factor, around = (state.t0 + state.t1) / 2) {
  const whole = (state.stop - state.start) * (1 + 2 * EDGE);
  const span = Math.min(whole, Math.max(shortest(state), (state.t1 - state.t0) * factor));
  const share = (around - state.t0) / (state.t1 - state.t0);
  setView(state, around - share * span, around + (1 - share) * span);
}

export function pan(state, seconds) {
  setView(state, state.t0 + seconds, state.t1 + seconds);
}

// A span with some room around it; a moment keeps the span in sight.
export function showSpan(state, start, stop) {
  const length = stop - start;
  if (length > 0) {
    setView(state, start - length * 0.25, stop + length * 0.25);
    return;
  }
  const half = Math.min((state.t1 - state.t0) / 2, (state.stop - state.start) / 8);
  setView(state, start - half, start + half);
}

export function moveInto(state, time) {
  if (time < state.t0 || time > state.t1) pan(state, time - (state.t0 + state.t1) / 2);
}
