// What is known of each file and each of its channels.
import { unitText } from '../data/bounds.js';
import { element } from './dom.js';
import { formatBytes, formatDuration, plural } from './format.js';

export const filesTab = { id: 'files', title: 'Files', create: (app) => new Files(app) };

const CHANNELS_LISTED = 500;
const TEXT_SHOWN = 400;

class Files {
  constructor(app) {
    const { state } = app;
    Object.assign(this, { state });
    this.element = element('div', { class: 'files', tabindex: '0', role: 'region', 'aria-label': 'Facts of the files' });
  }

  update() {
    const key = this.state.entries.map(({ number, version, checked }) => `${number} ${version} ${checked}`).join();
    if (key === this.shown) return;
    this.shown = key;
    this.element.replaceChildren(...this.state.entries.map((entry) => this.file(entry)));
    if (!this.state.entries.length) this.element.append(element('p', { class: 'empty' }, 'No file is open.'));
  }

  file({ name, recording, checked }) {
    const { metadata, channels } = recording;
    const facts = [
      ['Size', formatBytes(recording.size)],
      ['Time', `${formatDuration(recording.stop - recording.start)}, from ${recording.start} s`],
      ['Verdict', checked ?? recording.verdict],
      ['Closed', recording.closed ? 'yes' : 'no: the recording may go on'],
      ['Overview', recording.hasOverview ? 'in the file' : 'none'],
      ...Object.entries(metadata ?? {}).map(([key, value]) => [key, shortText(value)]),
    ];
    const list = element('dl', {}, ...facts.flatMap(([term, text]) => [element('dt', {}, term), element('dd', {}, element('bdi', {}, text))]));
    const head = ['Channel', 'Unit', 'Rate, Hz', 'Error bound', 'Codecs'].map((text) => element('th', { scope: 'col' }, text));
    const rows = channels.slice(0, CHANNELS_LISTED).map((channel) => element('tr', {}, ...[
      channel.label || `channel ${channel.index}`, unitText(channel.unit), channel.rateText ?? channel.rate,
      channel.bound, Object.entries(channel.codecs ?? {}).map(([band, codec]) => `${codec} ${band}`).join(', '),
    ].map((text) => element('td', {}, element('bdi', {}, String(text ?? ''))))));
    const more = channels.length - rows.length;
    return element('section', {},
      element('h2', {}, element('bdi', {}, name)), list,
      element('table', {}, element('thead', {}, element('tr', {}, ...head)), element('tbody', {}, ...rows)),
      more > 0 ? element('p', {}, `${plural(more, 'more channel')} not listed here.`) : null);
  }
}

function shortText(value) {
  const text = typeof value === 'string' ? value : JSON.stringify(value) ?? '';
  return text.length > TEXT_SHOWN ? `${text.slice(0, TEXT_SHOWN)}…` : text;
}
