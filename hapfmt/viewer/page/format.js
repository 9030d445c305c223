// Numbers, times and sizes as text; places for the ticks of an axis.

const DIGITS = 7;
const MOST_DECIMALS = 8;

// A value to seven digits.
export function formatValue(value) {
  if (!Number.isFinite(value)) return '–';
  if (value === 0) return '0';
  const size = Math.abs(value);
  if (size >= 1e7 || size < 1e-4) return trimmed(value.toExponential(DIGITS - 1));
  return trimmed(value.toPrecision(DIGITS));
}

// A value of a channel whose stored values are `step` apart, with the decimals that tell them apart.
export function formatStepped(value, step) {
  const decimals = decimalsOf(step);
  if (!Number.isFinite(value) || !(step > 0) || decimals > MOST_DECIMALS || Math.abs(value) >= 1e9) return formatValue(value);
  return value.toFixed(decimals).replace('-', '−');
}

function trimmed(text) {
  const [digits, exponent] = text.split('e');
  const short = digits.includes('.') ? digits.replace(/\.?0+$/, '') : digits;
  return (exponent === undefined ? short : `${short}e${exponent.replace('+', '')}`).replace('-', '−');
}

export function withUnit(text, unit) {
  return unit ? `${text} ${unit}` : text;
}

export function formatBytes(size) {
  if (size < 1000) return `${size} bytes`;
  const power = Math.min(3, Math.floor(Math.log10(size) / 3));
  return `${Number((size / 1000 ** power).toPrecision(3))} ${['', 'kB', 'MB', 'GB'][power]}`;
}

export function formatDuration(seconds) {
  if (seconds < 120) return `${Number(seconds.toPrecision(4))} s`;
  return clock(seconds, 0);
}

export function formatRate(rate) {
  return rate >= 1000 ? `${Number((rate / 1000).toPrecision(5))} kHz` : `${Number(rate.toPrecision(5))} Hz`;
}

// Decimals that tell times apart that are `step` seconds apart.
export function decimalsOf(step) {
  if (!(step > 0)) return 3;
  return Math.min(12, Math.max(0, Math.ceil(-Math.log10(step) - 1e-9)));
}

// 3725.5 -> 1:02:05.5
function clock(seconds, decimals) {
  const unit = 10 ** decimals;
  const whole = Math.round(Math.abs(seconds) * unit);
  const [minutes, rest] = [Math.floor(whole / (60 * unit)), whole % (60 * unit)];
  const last = (rest / unit).toFixed(decimals).padStart(decimals ? decimals + 3 : 2, '0');
  const hours = Math.floor(minutes / 60);
  const first = hours ? `${hours}:${String(minutes % 60).padStart(2, '0')}` : String(minutes);
  return `${seconds < 0 && whole ? '−' : ''}${first}:${last}`;
}

// A time of a view whose times reach to `largest` seconds.
export function formatTime(seconds, decimals, largest = 0) {
  if (!Number.isFinite(seconds)) return '–';
  if (largest >= 120 && decimals <= 6) return clock(seconds, decimals);
  const text = Math.abs(seconds).toFixed(decimals);
  return seconds < 0 && Number(text) !== 0 ? `−${text}` : text;
}

const CLOCK_STEPS = [120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400];

// The smallest of 1, 2, 5 times a power of ten (of minutes and hours beyond 60 s where `clocked`) that is not below `least`.
export function niceStep(least, clocked = false) {
  if (clocked && least > 5) {
    for (const step of [10, 15, 30, 60, ...CLOCK_STEPS]) if (step >= least) return step;
  }
  const power = 10 ** Math.floor(Math.log10(least));
  for (const digit of [1, 2, 5]) if (digit * power >= least * (1 - 1e-9)) return digit * power;
  return 10 * power;
}

// -> { step, values }: at most `most` multiples of a nice step in [low, high].
export function ticksBetween(low, high, most, clocked = false) {
  const span = high - low;
  if (!(span > 0) || !Number.isFinite(span)) return { step: 0, values: [] };
  const step = niceStep(span / Math.max(1, most), clocked);
  const values = [];
  const first = Math.ceil(low / step);
  for (let i = 0; i <= most + 1; i++) {
    const value = (first + i) * step;
    if (value > high) break;
    values.push(value);
  }
  return { step, values };
}

// Labels of an axis of values: all with the decimals of their step, or with a common power of ten.
export function axisLabels(values, step) {
  const largest = Math.max(...values.map(Math.abs), 0);
  if (largest >= 1e6 || (largest > 0 && largest < 1e-3)) {
    const power = Math.floor(Math.log10(largest));
    const decimals = Math.min(6, Math.max(0, power - Math.floor(Math.log10(step) + 1e-9)));
    return values.map((value) => (value === 0 ? '0' : trimmed(value.toExponential(decimals))));
  }
  const decimals = decimalsOf(step);
  return values.map((value) => value.toFixed(decimals).replace('-', '−'));
}

// A word of a command line.
export const quoted = (text) => (/^[\w.,:/+-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);

export function plural(count, noun) {
  return `${count} ${noun}${count === 1 ? '' : 's'}`;
}
