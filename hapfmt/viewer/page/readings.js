// Values of single samples at a time: the nearest sample of each channel.

const MOST_ASKED = 48;
const MOST_KEPT = 20000;

export class Readings {
  // onData() after each value that came.
  constructor(state, signals, onData) {
    Object.assign(this, { state, signals, onData });
    this.kept = new Map();
    this.asked = new Set();
  }

  bandOf(lane) {
    return this.state.bands.find((band) => lane.channel.bands.includes(band)) ?? 'sum';
  }

  // -> { number, time, value } of the sample nearest to a common time; value NaN where there is none; undefined: it is on its way.
  at(lane, time) {
    const { entry, rate, index } = lane;
    const band = this.bandOf(lane);
    const number = Math.round((time - entry.offset) * rate);
    const key = `${lane.key} ${band} ${number} ${entry.version ?? 0}`;
    const known = this.kept.get(key);
    if (known || this.asked.has(key) || this.asked.size >= MOST_ASKED) return known;
    const { start, stop } = entry.recording;
    if ((number + 0.5) / rate < start || (number - 0.5) / rate > stop) return { number, time: number / rate + entry.offset, value: NaN };
    this.ask(key, entry, index, band, number, rate);
    return undefined;
  }

  async ask(key, entry, index, band, number, rate) {
    this.asked.add(key);
    let reading = { number, time: number / rate + entry.offset, value: NaN };
    try {
      const { time, value } = await entry.recording.samples(index, (number - 0.5) / rate, (number + 0.5) / rate, band);
      if (time.length) reading = { number, time: time[0] + entry.offset, value: value[0] };
    } catch (error) {
      reading.message = error.message;
    }
    this.asked.delete(key);
    if (this.kept.size >= MOST_KEPT) this.kept.clear();
    this.kept.set(key, reading);
    this.onData();
  }
}
