// Samples as a table, in the layout of `hapfmt decode`: a column of times, a column for each channel, a row for each tick.
// A missing sample is an empty cell.
import { tickAt } from '../data/ticks.js';

const CELLS = 2 ** 16; // at a time
const CELL_BOUND = 3e7;
const GAP_ROWS = 1e6; // more rows without any sample are left out, where they are most
const DECIMALS = 18;

// As Python writes a float: the shortest digits that give the same bits.
export function floatText(value) {
  if (!Number.isFinite(value)) return value > 0 ? 'inf' : value < 0 ? '-inf' : 'nan';
  if (value === 0) return Object.is(value, -0) ? '-0.0' : '0.0';
  const [digits, power] = Math.abs(value).toExponential().split('e');
  const sign = value < 0 ? '-' : '';
  const exponent = Number(power);
  const letters = digits.replace('.', '');
  if (exponent < -4 || exponent >= 16) return `${sign}${digits}e${exponent < 0 ? '-' : '+'}${String(Math.abs(exponent)).padStart(2, '0')}`;
  if (exponent < 0) return `${sign}0.${'0'.repeat(-exponent - 1)}${letters}`;
  const whole = letters.slice(0, exponent + 1).padEnd(exponent + 1, '0');
  return `${sign}${whole}.${letters.slice(exponent + 1) || '0'}`;
}

// -> text(tick): seconds as an exact decimal, else as the nearest double.
export function timesOf(num, den) {
  let decimals = 0;
  while ((10n ** BigInt(decimals) * BigInt(den)) % BigInt(num) !== 0n) {
    decimals++;
    if (decimals > DECIMALS) return (tick) => floatText((tick * den) / num);
  }
  const scaled = (10n ** BigInt(decimals) * BigInt(den)) / BigInt(num);
  if (!decimals) return (tick) => String(BigInt(tick) * scaled);
  const small = Number(scaled) * 2 ** 20 < Number.MAX_SAFE_INTEGER;
  return (tick) => {
    const product = small && tick < 2 ** 20 ? tick * Number(scaled) : BigInt(tick) * scaled;
    const text = String(product).padStart(decimals + 1, '0');
    return `${text.slice(0, -decimals)}.${text.slice(-decimals)}`;
  };
}

export function columnName(label, unit) {
  const name = `${label.trim()} [${unit || '1'}]`;
  if (/[\n\r]/.test(name)) throw new Error('the label of a channel has a line break, which a table cannot contain');
  return !/^[ #]|[",;\t]/.test(name) ? name : `"${name.replaceAll('"', '""')}"`;
}

// Rates as whole numbers: [num, den] in lowest terms.
export function ratioOf({ rate, rateText }) {
  const [num, den = 1] = String(rateText ?? rate).split('/').map(Number);
  return [num, den];
}

// Channels by their rates: [{ num, den, channels }].
export function byRate(channels) {
  const groups = new Map();
  for (const channel of channels) {
    const [num, den] = ratioOf(channel);
    const key = `${num}/${den}`;
    if (!groups.has(key)) groups.set(key, { num, den, channels: [] });
    groups.get(key).channels.push(channel);
  }
  return [...groups.values()];
}

// The table of channels of one rate, [t0, t1): { parts: [text], rows, leftOut }. Throws where it is too large.
export async function tableOf(recording, { num, den, channels }, [t0, t1], { band = 'sum', signal, onProgress = () => {} } = {}) {
  const [first, stop] = [t0, t1].map((time) => tickAt({ rateNum: num, rateDen: den }, time));
  if ((stop - first) * channels.length > CELL_BOUND) throw new Error('the table would have more than 30 million cells');
  const time = timesOf(num, den);
  const empty = ','.repeat(channels.length);
  const found = []; // texts, and runs of rows without any sample
  let gap = null;
  let rows = 0;
  let gapRows = 0;
  const step = Math.max(16, Math.floor(CELLS / channels.length));
  for (let at = first; at < stop; at += step) {
    const end = Math.min(at + step, stop);
    const columns = await Promise.all(channels.map(({ index }) => column(recording, index, band, num, den, at, end, signal)));
    channels.forEach((channel, i) => checkWhole(channel, columns[i].values));
    const lines = [];
    const flush = () => {
      if (lines.length) found.push(lines.splice(0).join(''));
    };
    for (let tick = at; tick < end; tick++) {
      if (!columns.some(({ has }) => has[tick - at])) {
        gap ??= tick;
        continue;
      }
      if (gap !== null && rows) {
        flush();
        found.push([gap, tick]);
        gapRows += tick - gap;
      }
      gap = null;
      rows++;
      let line = time(tick);
      for (const { values } of columns) {
        const value = values[tick - at];
        line += value === value ? `,${floatText(value)}` : ',';
      }
      lines.push(`${line}\n`);
    }
    flush();
    onProgress((end - first) / (stop - first));
  }
  const leftOut = gapRows > Math.max(GAP_ROWS, rows) ? gapRows : 0;
  const parts = [`${['t [s]', ...channels.map(({ label, unit }) => columnName(label, unit))].join(',')}\n`];
  for (const one of found) {
    if (typeof one === 'string') parts.push(one);
    else if (!leftOut) {
      const lines = [];
      for (let tick = one[0]; tick < one[1]; tick++) lines.push(`${time(tick)}${empty}\n`);
      parts.push(lines.join(''));
    }
  }
  return { parts, rows, leftOut };
}

// A Number cannot tell larger integers apart.
function checkWhole({ label, index, numberFormat }, values) {
  if (numberFormat !== 'int64' && numberFormat !== 'uint64') return;
  if (values.some((value) => Math.abs(value) > Number.MAX_SAFE_INTEGER)) {
    throw new Error(`Channel ${label || index} has integers that a table would round`);
  }
}

// Values of the ticks [at, end), and where there is a sample.
async function column(recording, index, band, num, den, at, end, signal) {
  const seconds = (tick) => ((tick - 0.5) * den) / num;
  const tickOf = (time) => Math.round((time * num) / den);
  const values = new Float64Array(end - at).fill(NaN);
  const has = new Uint8Array(end - at);
  const { time, value, gaps } = await recording.samples(index, seconds(at), seconds(end), band, { signal });
  if (!time.length) return { values, has };
  const from = tickOf(time[0]) - at;
  values.set(value, from);
  has.fill(1, from, from + value.length);
  for (const [start, stop] of gaps) has.fill(0, tickOf(start) - at, tickOf(stop) - at);
  return { values, has };
}
