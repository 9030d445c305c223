// A signal for the two motors of a gamepad: how strong each is in frames of time. It follows docs/spec/players.md in
// small: a limit, ramps, rest in gaps, no late frames.

export const FRAME = 0.05; // seconds
export const LIMIT = 0.5; // of what the motors can
const SLEW = 0.5; // most change in a frame, of the limit
const HOLD = 0.1; // seconds that a command lasts; then the gamepad rests by itself
const LATE = 0.25; // seconds; a page that is later stops

// slow and fast: samples of the strong and of the weak motor, NaN where missing, or null. -> [{ strong, weak }], 0 to 1;
// the strongest frame of each motor is 1. The last frame is at rest.
export function framesOf(slow, fast, rate) {
  const frames = Math.ceil((slow ?? fast).length / rate / FRAME);
  const strong = levels(slow, rate, frames);
  const weak = levels(fast, rate, frames);
  return Array.from({ length: frames + 1 }, (_, i) => ({ strong: strong[i] ?? 0, weak: weak[i] ?? 0 }));
}

function levels(values, rate, frames) {
  const found = new Float64Array(frames);
  if (!values) return found;
  for (let n = 0; n < frames; n++) {
    const from = Math.floor(n * FRAME * rate);
    const stop = Math.min(values.length, Math.max(from + 1, Math.floor((n + 1) * FRAME * rate)));
    let sum = 0;
    for (let i = from; i < stop; i++) sum += values[i] * values[i];
    found[n] = Number.isFinite(sum) && stop > from ? Math.sqrt(sum / (stop - from)) : 0; // a gap is at rest
  }
  const most = found.reduce((a, b) => Math.max(a, b), 0);
  if (most > 0) for (let n = 0; n < frames; n++) found[n] /= most;
  return found;
}

// Sends frames to an actuator, one each 50 ms, until the end, a stop or an error.
export class Rumble {
  // actuator: { playEffect(type, parameters), reset() }; strength(): 0 to 1 of the limit, asked for each frame;
  // ended(why): it is at rest. now() in seconds; every(seconds, action) -> stop().
  constructor(actuator, frames, { strength, moved = () => {}, ended, now, every }) {
    Object.assign(this, { actuator, frames, strength, moved, ended, now, last: { strong: 0, weak: 0 }, running: true });
    this.began = this.before = now();
    this.cancel = every(FRAME, () => this.tick());
    this.tick();
  }

  tick() {
    if (!this.running) return;
    const time = this.now();
    const n = Math.floor((time - this.began) / FRAME);
    if (time - this.before > LATE) this.stop('The page was late.');
    else if (n >= this.frames.length) this.stop('It is at the end.');
    else {
      this.before = time;
      this.moved(n * FRAME);
      this.send(this.frames[n]);
    }
  }

  send({ strong, weak }) {
    const gain = LIMIT * Math.max(0, Math.min(1, this.strength()));
    const near = (wanted, last) => Math.max(last - SLEW * LIMIT, Math.min(last + SLEW * LIMIT, wanted));
    const limited = (value) => Math.max(0, Math.min(LIMIT, value));
    this.last = { strong: limited(near(gain * strong, this.last.strong)), weak: limited(near(gain * weak, this.last.weak)) };
    this.play(this.last.strong, this.last.weak, HOLD);
  }

  play(strongMagnitude, weakMagnitude, seconds) {
    try {
      const played = this.actuator.playEffect('dual-rumble', { startDelay: 0, duration: 1000 * seconds, strongMagnitude, weakMagnitude });
      Promise.resolve(played).catch((error) => this.stop(`The gamepad refused: ${error.message}`));
    } catch (error) {
      this.stop(`The gamepad refused: ${error.message}`);
    }
  }

  // Both motors rest.
  stop(why) {
    if (!this.running) return;
    this.running = false;
    this.cancel?.();
    this.play(0, 0, HOLD);
    try {
      Promise.resolve(this.actuator.reset?.()).catch(() => {});
    } catch {
      // A command lasts 0.1 s: it rests by itself.
    }
    this.ended(why);
  }
}
