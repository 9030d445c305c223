// Each file: its verdict and a drawing of each channel.
import { channelsOf } from '../decoder/channels.js';
import { decodeFile } from '../decoder/decode.js';
import { openFile } from '../decoder/file.js';
import { listSources } from './sources.js';

const main = document.getElementById('recordings');

function add(parent, tag, text) {
  const element = document.createElement(tag);
  element.textContent = text;
  parent.append(element);
  return element;
}

async function bytesOf({ url, bytes }) {
  if (bytes) return bytes;
  const answer = await fetch(url);
  if (!answer.ok) throw new Error(`the server answers ${answer.status}`);
  return new Uint8Array(await answer.arrayBuffer());
}

async function show(source) {
  const section = add(main, 'section', '');
  add(section, 'h1', source.name);
  const file = openFile(await bytesOf(source));
  if (file.refused) throw file.refused;
  const { channels } = channelsOf(file, decodeFile(file));
  for (const channel of channels) {
    const label = channel.track.labels[channel.component];
    const unit = channel.track.units[channel.component];
    const values = channel.parts.flatMap((part) => Array.from(part.numbers()));
    const title = `${label || `channel ${channel.channel}`} (${values.length} samples)`;
    const data = [values.map((_, i) => i), values];
    new uPlot({ title, width: 800, height: 160, scales: { x: { time: false } }, series: [{}, { label: unit }] }, data, section);
  }
  return { name: source.name, channels: channels.length };
}

const ready = Promise.all(listSources().map(async (source) => {
  try {
    return await show(source);
  } catch (error) {
    add(main, 'p', `${source.name}: ${error.message}`);
    return { name: source.name, error: error.message };
  }
}));
window.hapf = { ready };
