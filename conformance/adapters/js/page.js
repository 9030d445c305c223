// A page that reads one file: verdict, channels, damage, a plot of each channel.
import { channelsOf } from './channels.js';
import { decodeFile } from './decode.js';
import { HapfError } from './error.js';
import { recoverFile } from './recover.js';
import { reportOf } from './report.js';
import { verifyFile } from './verify.js';

const PLOTS = 24;
const ROWS = 200;
const COLORS = ['#36c', '#c33', '#283', '#a3a', '#b60', '#099'];
const find = (id) => document.getElementById(id);

// Texts of a file are only ever shown as text (clause 17).
function element(name, text, parent, className) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  parent?.append(made);
  return made;
}

function section(id, show) {
  const place = find(id);
  while (place.children.length > 1) place.lastChild.remove();
  place.hidden = !show;
  return place;
}

function table(parent, names, rows) {
  const made = element('table', undefined, parent);
  const head = element('tr', undefined, made);
  for (const name of names) element('th', name, head);
  for (const row of rows.slice(0, ROWS)) {
    const line = element('tr', undefined, made);
    for (const cell of row) element('td', String(cell ?? ''), line);
  }
  if (rows.length > ROWS) element('p', `and ${rows.length - ROWS} more`, parent);
}

// The lowest and the highest number of each column of pixels; a gap stays a gap.
function plot(canvas, channel) {
  const { track, component, spans, parts } = channel;
  const width = canvas.clientWidth || 800;
  const height = canvas.clientHeight || 200;
  canvas.width = width;
  canvas.height = height;
  const start = spans[0][0];
  const stop = spans[spans.length - 1][1];
  const low = new Float64Array(width).fill(Infinity);
  const high = new Float64Array(width).fill(-Infinity);
  const { A, B, D } = track.calibrations[component];
  const words = track.numberFormat !== 'counts';
  for (const part of parts) {
    const numbers = part.numbers();
    let i = 0;
    for (const [from, to] of part.spans) {
      for (let t = from; t < to; t++, i++) {
        const value = words ? Number(numbers[i]) : (numbers[i] * A + B) / D;
        const x = Math.floor(((t - start) / (stop - start)) * width);
        if (value < low[x]) low[x] = value;
        if (value > high[x]) high[x] = value;
      }
    }
  }
  const least = low.reduce((a, b) => Math.min(a, b), Infinity);
  const most = high.reduce((a, b) => Math.max(a, b), -Infinity);
  const scale = most > least ? (height - 8) / (most - least) : 0;
  const y = (value) => height - 4 - (scale ? (value - least) * scale : height / 2);
  const pen = canvas.getContext('2d');
  pen.fillStyle = COLORS[channel.channel % COLORS.length];
  for (let x = 0; x < width; x++) {
    if (low[x] <= high[x]) pen.fillRect(x, y(high[x]), 1, Math.max(y(low[x]) - y(high[x]), 1.5));
  }
}

function showChannels(file, report) {
  const place = section('channels', !file.refused);
  if (file.refused) return;
  const lost = new Map(report.channels.map((one) => [one.channel, one]));
  const { channels } = channelsOf(file, decodeFile(file, { exact: false }));
  table(place, ['channel', 'label', 'unit', 'rate', 'samples', 'lost ticks'], channels.map(({ channel, track, component, spans }) => [
    channel, track.labels[component], track.units[component], `${track.rateNum / track.rateDen} Hz`,
    spans.reduce((sum, [start, stop]) => sum + stop - start, 0), lost.get(channel)?.lost_ticks ?? 'unknown',
  ]));
  for (const channel of channels.filter(({ spans }) => spans.length).slice(0, PLOTS)) {
    element('div', `${channel.channel} ${channel.track.labels[channel.component]}`, place);
    plot(element('canvas', undefined, place), channel);
  }
}

function spansText({ lost }) {
  return lost.slice(0, 10).map(({ track, start, stop }) => `track ${track}: ${start} to ${stop ?? '?'}`).join(', ');
}

function show(name, bytes) {
  find('result').hidden = false;
  find('name').textContent = name;
  const verdict = find('verdict');
  try {
    const file = verifyFile(bytes);
    const report = reportOf(file);
    verdict.className = `verdict ${file.verdict}`;
    verdict.textContent = file.verdict;
    // CHK-009: nothing is shown as if the file were understood.
    if (file.criticalUnknown) section('channels', false);
    else showChannels(file, report);
    const rows = report.damages.map((one) => [one.code, one.offset, one.size, one.message, spansText(one)]);
    if (report.lost.length) rows.push(['', '', '', 'lost besides', spansText(report)]);
    table(section('damages', rows.length > 0), ['code', 'offset', 'bytes', 'what', 'lost ticks'], rows);
    table(section('findings', report.findings.length > 0), ['rule', 'offset', 'what'],
      report.findings.map(({ requirement, offset, message }) => [requirement, offset, message]));
    find('save').hidden = file.verdict === 'intact' || Boolean(file.refused);
    find('recover').onclick = () => save(name, recoverFile(bytes).bytes);
  } catch (error) {
    verdict.className = 'verdict error';
    verdict.textContent = error instanceof HapfError ? error.message : `internal error: ${error.message}`;
  }
}

function save(name, bytes) {
  const link = element('a');
  link.href = URL.createObjectURL(new Blob([bytes], { type: 'application/vnd.hapf' }));
  link.download = name.replace(/(\.hapf)?$/, '-recovered.hapf');
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

async function take(file) {
  if (file) show(file.name, new Uint8Array(await file.arrayBuffer()));
}

const drop = find('drop');
addEventListener('dragover', (event) => {
  event.preventDefault();
  drop.classList.add('over');
});
addEventListener('dragleave', () => drop.classList.remove('over'));
addEventListener('drop', (event) => {
  event.preventDefault();
  drop.classList.remove('over');
  take(event.dataTransfer.files[0]);
});
find('file').addEventListener('change', (event) => take(event.target.files[0]));
