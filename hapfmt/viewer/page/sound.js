// A signal as sound: its samples between -1 and 1, at a rate that every AudioContext takes.

const LEAST_RATE = 3000; // an AudioBuffer takes this rate
const WANTED_RATE = 8000; // at least this one, of slower signals
const REACH = 16; // samples on each side that an interpolated one depends on
const FADE = 0.005; // seconds, at the ends and at gaps

// values: NaN where missing. -> { samples: Float32Array, rate, factor }; rate is `factor` times that of the values.
export function soundOf(values, rate) {
  const level = levelled(values, Math.max(1, Math.round(FADE * rate)));
  const factor = rate >= LEAST_RATE ? 1 : Math.ceil(WANTED_RATE / rate);
  const samples = factor === 1 ? Float32Array.from(level) : interpolated(level, factor);
  let peak = 0;
  for (const sample of samples) peak = Math.max(peak, Math.abs(sample));
  if (peak > 0) for (let i = 0; i < samples.length; i++) samples[i] /= peak;
  return { samples, rate: rate * factor, factor };
}

// Without the mean; 0 in gaps; faded in and out over `fade` samples. The largest is 1.
function levelled(values, fade) {
  let count = 0;
  let largest = 0;
  for (const value of values) {
    if (!Number.isFinite(value)) continue;
    count++;
    largest = Math.max(largest, Math.abs(value));
  }
  const scale = largest > 0 ? 1 / largest : 0;
  let sum = 0;
  for (const value of values) if (Number.isFinite(value)) sum += value * scale;
  const mean = count ? sum / count : 0;
  const level = new Float64Array(values.length);
  for (let from = 0; from < values.length;) {
    let stop = from;
    while (stop < values.length && Number.isFinite(values[stop])) stop++;
    for (let i = from; i < stop; i++) {
      const edge = Math.min(i - from, stop - 1 - i);
      const gain = edge < fade ? 0.5 - 0.5 * Math.cos((Math.PI * (edge + 0.5)) / fade) : 1;
      level[i] = (values[i] * scale - mean) * gain;
    }
    from = Math.max(stop, from + 1);
  }
  return level;
}

// Band-limited interpolation by a sinc in a Hann window.
function interpolated(values, factor) {
  const weights = Array.from({ length: factor }, (_, phase) => Float64Array.from({ length: 2 * REACH }, (_unused, j) => {
    const x = j - REACH + 1 - phase / factor;
    const sinc = x === 0 ? 1 : Math.sin(Math.PI * x) / (Math.PI * x);
    return Math.abs(x) >= REACH ? 0 : sinc * (0.5 + 0.5 * Math.cos((Math.PI * x) / REACH));
  }));
  const samples = new Float32Array(values.length * factor);
  for (let i = 0; i < values.length; i++) {
    for (let phase = 0; phase < factor; phase++) {
      const weight = weights[phase];
      let sum = 0;
      const first = Math.max(0, REACH - 1 - i);
      const last = Math.min(2 * REACH, values.length + REACH - 1 - i);
      for (let j = first; j < last; j++) sum += weight[j] * values[i + j - REACH + 1];
      samples[i * factor + phase] = sum;
    }
  }
  return samples;
}
