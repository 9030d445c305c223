// The channel in focus as sound, and on the motors of a gamepad.
import { eachPart, laneInFocus, namedLane, spanFor, spanText } from './chosen.js';
import { element, setText } from './dom.js';
import { formatDuration } from './format.js';
import { LIMIT, Rumble, framesOf } from './rumble.js';
import { soundOf } from './sound.js';
import { laneChoice } from './tab-spectrogram.js';

const MOST_SOUND = 300; // seconds
const MOST_RUMBLE = 60;
const MOST_SAMPLES = 2e7;
const HEARD = 40; // Hz: signals of lower rates have no sound
const RAMP = 0.02; // seconds
const START = { volume: 10, strength: 10 }; // percent

const SAFETY = [
  'Rumble moves a machine that touches a person. If you connect a device to a person, you are responsible for it.',
  `The strength starts at ${START.strength} % and never exceeds ${100 * LIMIT} % of what the motors can. Gaps are at rest.`,
  'It stops at Esc, at Stop, at the end, and when you leave the page. If the page fails, the last command ends after 0.1 s, provided that the gamepad works.',
  'No real gamepad was driven in the tests of this program. Try it first with nobody at the gamepad.',
];

export const playTab = { id: 'play', title: 'Play', create: (app) => new Play(app) };

// All values of one band in the span.
async function valuesOf(lane, span, band, signal) {
  const parts = [];
  await eachPart(lane, span, band, signal, ({ value }) => parts.push(value));
  const values = new Float64Array(parts.reduce((sum, { length }) => sum + length, 0));
  let at = 0;
  for (const part of parts) {
    values.set(part, at);
    at += part.length;
  }
  return values;
}

function withoutMean(values) {
  const known = values.filter(Number.isFinite);
  const mean = known.reduce((sum, value) => sum + value / known.length, 0);
  return values.map((value) => value - mean);
}

class Play {
  constructor(app) {
    const { state, panels } = app;
    Object.assign(this, { app, state, panels, running: null });
    this.lanes = laneChoice(app);
    this.span = element('span', { class: 'said' });
    this.volume = this.slider('Volume', START.volume, 100, () => this.running?.setVolume?.(this.volume.value / 100));
    this.strength = this.slider('Strength', START.strength, 100 * LIMIT, () => {});
    const button = (text, run) => element('button', { type: 'button', onclick: run }, text);
    this.sound = button('Play sound', () => this.start((signal) => this.playSound(signal)));
    this.rumble = button('Play rumble', () => this.start((signal) => this.playRumble(signal)));
    this.stopButton = button('Stop', () => this.stop('Stopped.'));
    this.said = element('p', { class: 'said', role: 'status' });
    this.about = element('span', { class: 'said' });
    this.pad = element('span', { class: 'said' });
    this.arm = button('I have read this: allow rumble', () => {
      this.armed = true;
      this.update();
      this.rumble.focus();
    });
    this.armed = false; // until a click, after each load of the page
    this.warning = element('div', { class: 'warning', role: 'group', 'aria-label': 'Safety of rumble' },
      ...SAFETY.map((text) => element('p', {}, text)), this.arm);
    this.controls = element('div', { class: 'bar' }, this.rumble, this.strength.label, this.pad);
    this.element = element('div', { class: 'play' },
      element('div', { class: 'bar' }, this.lanes.choice, this.span, this.stopButton),
      element('div', { class: 'bar' }, this.sound, this.volume.label, this.about),
      this.controls, this.warning, this.said);
    this.line = element('div', { class: 'line playing', hidden: true }, element('span', { class: 'tag' }));
    document.getElementById('lines').append(this.line);
    // Esc only ends what plays; without it, the page takes the key.
    window.addEventListener('keydown', (event) => {
      if (event.key !== 'Escape' || !this.running) return;
      event.preventDefault();
      event.stopImmediatePropagation();
      this.stop('Stopped.');
    }, true);
    for (const name of ['blur', 'pagehide']) window.addEventListener(name, () => this.running?.moves && this.stop('Stopped: the page was left.'));
    document.addEventListener('visibilitychange', () => document.hidden && this.running?.moves && this.stop('Stopped: the page was left.'));
    for (const name of ['gamepadconnected', 'gamepaddisconnected']) window.addEventListener(name, () => this.padsChanged());
  }

  slider(text, start, most, onInput) {
    const shown = element('output', {}, `${start} %`);
    const input = element('input', {
      type: 'range', min: 1, max: most, step: 1, value: start, 'aria-label': text,
      oninput: () => {
        setText(shown, `${input.value} %`);
        onInput();
      },
    });
    input.label = element('label', {}, text, input, shown);
    return input;
  }

  // The first gamepad with motors; else why there is none.
  findPad() {
    let pads;
    try {
      pads = [...navigator.getGamepads()].filter(Boolean);
    } catch {
      return { why: 'This browser gives no gamepads to this page.' };
    }
    if (!pads.length) return { why: 'No gamepad is known. Press one of its buttons.' };
    const pad = pads.find(({ vibrationActuator }) => vibrationActuator?.playEffect);
    return pad ? { pad } : { why: `${pads[0].id}: this browser cannot drive its motors.` };
  }

  padsChanged() {
    const { moves } = this.running ?? {};
    if (moves && !this.findPad().pad) this.stop('Stopped: the gamepad is gone.');
    this.update();
  }

  get lane() {
    return laneInFocus(this.app);
  }

  // Seconds of the lane, of which only the first play.
  spanOf(lane, most) {
    const span = spanFor(this.app, lane.entry);
    return span && [span[0], Math.min(span[1], span[0] + most, span[0] + MOST_SAMPLES / lane.rate)];
  }

  update() {
    const { lane } = this;
    this.lanes.update();
    setText(this.span, spanText(this.app));
    const span = lane && spanFor(this.app, lane.entry);
    const split = lane?.channel.bands.includes('hf');
    const long = (most) => {
      const limit = Math.min(most, MOST_SAMPLES / (lane?.rate ?? 1));
      return span && span[1] - span[0] > limit ? ` Only the first ${formatDuration(limit)} play.` : '';
    };
    const slow = span && lane.rate < HEARD;
    if (slow) setText(this.about, `The rate of ${lane.rate} Hz is too low for a sound.`);
    else setText(this.about, span ? `${split ? 'The HF band' : 'The signal without its mean'}. The loudest sample is at the chosen volume.${long(MOST_SOUND)}` : 'No samples are chosen.');
    const { pad, why } = this.findPad();
    const motors = split ? 'LF drives the strong motor, HF the weak one.' : 'The channel has no bands: the signal without its mean drives the strong motor.';
    setText(this.pad, pad ? `${pad.id}. ${motors}${long(MOST_RUMBLE)}` : why);
    this.warning.hidden = this.armed;
    this.controls.hidden = !this.armed;
    const busy = this.running !== null;
    this.sound.disabled = busy || !span || slow;
    this.rumble.disabled = busy || !span || !pad;
    this.stopButton.disabled = !busy;
  }

  // One thing plays at a time.
  async start(play) {
    this.stop('');
    const control = new AbortController();
    this.running = { halt: () => control.abort() };
    this.update();
    setText(this.said, 'Reading …');
    try {
      await play(control.signal);
    } catch (error) {
      if (!control.signal.aborted) this.stop(`It cannot play: ${error.message}`);
    }
  }

  stop(text) {
    const { running } = this;
    this.running = null;
    running?.halt(text);
    this.line.hidden = true;
    setText(this.said, text);
    this.update();
  }

  async playSound(signal) {
    const { lane } = this;
    const span = this.spanOf(lane, MOST_SOUND);
    // Within the click: a browser lets no other begin to sound.
    const context = new AudioContext();
    let source = null;
    const gain = context.createGain();
    const halt = () => {
      gain.gain.setTargetAtTime(0, context.currentTime, RAMP / 3);
      setTimeout(() => {
        source?.stop();
        context.close();
      }, 2000 * RAMP);
    };
    const { halt: drop } = this.running;
    this.running = { halt: () => [drop(), halt()] };
    const values = await valuesOf(lane, span, lane.channel.bands.includes('hf') ? 'hf' : 'sum', signal);
    if (signal.aborted) return;
    const { samples, rate } = soundOf(values, lane.rate);
    const buffer = context.createBuffer(1, Math.max(1, samples.length), rate);
    buffer.copyToChannel(samples, 0);
    const played = context.createBufferSource();
    played.buffer = buffer;
    played.connect(gain);
    gain.connect(context.destination);
    gain.gain.value = this.volume.value / 100;
    this.running.setVolume = (volume) => gain.gain.setTargetAtTime(volume, context.currentTime, RAMP);
    await context.resume();
    if (signal.aborted) return;
    played.onended = () => !signal.aborted && this.stop('It is at the end.');
    const began = context.currentTime;
    played.start();
    source = played;
    setText(this.said, `${namedLane(this.app, lane)} sounds.`);
    const { running } = this;
    const follow = () => {
      if (this.running !== running) return;
      this.showPlace(span[0] + lane.entry.offset + context.currentTime - began);
      requestAnimationFrame(follow);
    };
    follow();
  }

  async playRumble(signal) {
    const { lane } = this;
    const { pad } = this.findPad();
    if (!this.armed || !pad) {
      this.stop('');
      return;
    }
    this.running.moves = true;
    const span = this.spanOf(lane, MOST_RUMBLE);
    const split = lane.channel.bands.includes('hf');
    const values = await valuesOf(lane, span, split ? 'lf' : 'sum', signal);
    const slow = split ? values : withoutMean(values);
    const fast = split ? await valuesOf(lane, span, 'hf', signal) : null;
    if (signal.aborted) return;
    const { halt: drop } = this.running;
    const rumble = new Rumble(pad.vibrationActuator, framesOf(slow, fast, lane.rate), {
      strength: () => this.strength.value / (100 * LIMIT),
      moved: (time) => this.showPlace(span[0] + lane.entry.offset + time),
      ended: (why) => this.running?.moves && this.stop(why),
      now: () => performance.now() / 1000,
      every: (seconds, action) => {
        const timer = setInterval(action, 1000 * seconds);
        return () => clearInterval(timer);
      },
    });
    if (!rumble.running) return;
    this.running = { moves: true, halt: (why) => [drop(), rumble.stop(why)] };
    setText(this.said, `${namedLane(this.app, lane)} moves ${pad.id}.`);
    this.update();
  }

  showPlace(time) {
    const x = this.panels.xOf(time);
    this.line.hidden = time < this.state.t0 || time > this.state.t1;
    this.line.style.transform = `translateX(${x}px)`;
    setText(this.line.firstChild, this.app.cursors.text(time));
  }
}
