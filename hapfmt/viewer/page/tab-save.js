// Saving what is in sight as a picture, and the selection as a table or as a part of the recording.
import { laneInFocus, spanFor, spanText } from './chosen.js';
import { byRate, tableOf } from './csv.js';
import { element, setText } from './dom.js';
import { formatBytes, formatRate, plural, quoted } from './format.js';
import { pictureOf } from './picture.js';
import { BANDS } from './theme.js';

export const saveTab = { id: 'save', title: 'Save', create: (app) => new Save(app) };

const stemOf = (name) => name.replace(/\.hapf$/i, '') || 'recording';

export function download(blob, name) {
  const url = URL.createObjectURL(blob);
  element('a', { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 60000);
}

const edge = (seconds) => Number(seconds.toFixed(6));

class Save {
  constructor(app) {
    const { state, readings } = app;
    Object.assign(this, { app, state, readings });
    const button = (text, run) => element('button', { type: 'button', onclick: () => this.run(run) }, text);
    this.buttons = [
      button('Save picture (.png)', () => this.savePicture()),
      button('Save table (.csv)', (signal) => this.saveTables(signal)),
      button('Save part (.hapf)', (signal) => this.saveParts(signal)),
    ];
    this.texts = this.buttons.map((one) => element('span', { id: `about-${one.textContent.match(/\.(\w+)/)[1]}` }));
    this.buttons.forEach((one, i) => one.setAttribute('aria-describedby', this.texts[i].id));
    this.stop = element('button', { type: 'button', hidden: true, onclick: () => this.control?.abort() }, 'Stop');
    this.said = element('div', { class: 'said', role: 'status' });
    this.span = element('span', { class: 'said' });
    this.element = element('div', { class: 'save', tabindex: '0' },
      element('p', {}, this.span),
      ...this.buttons.map((one, i) => element('p', {}, one, this.texts[i])),
      element('p', {}, this.stop, this.said));
    this.control = null;
  }

  // Each file with the shown channels and seconds of it.
  chosen() {
    return this.state.entries.map((entry) => ({
      entry, span: spanFor(this.app, entry), lanes: this.state.lanes.filter((lane) => lane.entry === entry),
    })).filter(({ span, lanes }) => span && lanes.length);
  }

  // Tables: those of one band and rate of one file.
  tables() {
    return this.chosen().flatMap(({ entry, span, lanes }) => {
      const bands = [...new Set(lanes.map((lane) => this.readings.bandOf(lane)))];
      return bands.flatMap((band) => byRate(lanes.filter((lane) => this.readings.bandOf(lane) === band).map(({ channel }) => channel))
        .map((group) => ({ entry, span, band, ...group })));
    });
  }

  update() {
    setText(this.span, `${spanText(this.app)}. ${plural(this.state.lanes.length, 'channel')}.`);
    const tables = this.tables();
    const rates = [...new Set(tables.map(({ num, den }) => formatRate(num / den)))];
    const bands = [...new Set(tables.map(({ band }) => BANDS[band]))];
    const many = rates.length > 1 ? ` One table has one rate: you get ${tables.length} files, for ${rates.join(', ')}.`
      : tables.length > 1 ? ` You get ${tables.length} files.` : '';
    const band = bands.length === 1 && bands[0] === BANDS.sum ? '' : ` Band: ${bands.join(', ')}.`;
    const parts = this.chosen().length;
    setText(this.texts[0], 'What is in sight, with axes and labels.');
    setText(this.texts[1], `The samples of the shown channels, as hapfmt decode writes them. Events are not in it.${band}${many}`);
    setText(this.texts[2], `The packets that the samples are in, copied and not encoded again. A packet stays whole, so the part may be a little longer. `
      + `Events and attachments come along.${parts > 1 ? ` You get ${parts} files.` : ''}`);
    const none = !laneInFocus(this.app);
    this.buttons.forEach((one) => {
      one.disabled = none || this.control !== null;
    });
    this.stop.hidden = this.control === null;
  }

  async run(action) {
    const control = new AbortController();
    this.control = control;
    this.update();
    setText(this.said, 'Working …');
    try {
      setText(this.said, await action(control.signal));
    } catch (error) {
      setText(this.said, control.signal.aborted ? 'Stopped. Nothing was saved.' : `Not saved. ${error.message}`);
    }
    this.control = null;
    this.update();
  }

  async savePicture() {
    const canvas = pictureOf(this.app);
    if (!canvas) return 'No chart is in sight.';
    const blob = await new Promise((done) => { canvas.toBlob(done, 'image/png'); });
    const name = `${stemOf(this.state.entries[0].name)}.png`;
    download(blob, name);
    return `Saved ${name}, ${canvas.width} × ${canvas.height} pixels.`;
  }

  async saveTables(signal) {
    const tables = this.tables();
    if (!tables.length) return 'No sample is in the selection.';
    const saved = [];
    for (const table of tables) {
      const { entry, span, band, num, den } = table;
      const same = tables.filter((one) => one.entry === entry);
      const rate = same.some((one) => one.num !== num || one.den !== den) ? `-${den === 1 ? num : `${num}-${den}`}Hz` : '';
      const name = `${stemOf(entry.name)}${band === 'sum' ? '' : `-${band}`}${rate}.csv`;
      const onProgress = (share) => setText(this.said, `${name}: ${Math.floor(100 * share)} %`);
      const found = await tableOf(entry.recording, table, span, { band, signal, onProgress }).catch((error) => {
        throw signal.aborted ? error : new Error(`${name}: ${error.message}. Use: ${this.command('decode', table, `${stemOf(entry.name)}.csv`)}`);
      });
      if (!found.rows) {
        saved.push(`${name} was not saved: it would have no sample.`);
        continue;
      }
      download(new Blob(found.parts, { type: 'text/csv' }), name);
      const out = found.leftOut ? ` ${plural(found.leftOut, 'row')} without any sample were left out.` : '';
      saved.push(`Saved ${name}, ${plural(found.rows, 'row')} with samples.${out}`);
    }
    return saved.join(' ');
  }

  async saveParts(signal) {
    const chosen = this.chosen();
    if (!chosen.length) return 'No sample is in the selection.';
    const saved = [];
    for (const { entry, span: [t0, t1], lanes } of chosen) {
      const { recording } = entry;
      const name = `${stemOf(entry.name)}-part.hapf`;
      const channels = lanes.map(({ index }) => index);
      const whole = t0 <= recording.start && t1 >= recording.stop;
      const asked = { channels, name: stemOf(entry.name), ...(whole ? {} : { t0, t1 }) };
      const onProgress = (done, of) => setText(this.said, `${entry.name}: read ${Math.floor((100 * done) / of)} %`);
      const part = await recording.subset(asked, { signal, onProgress }).catch((error) => {
        if (signal.aborted) throw error;
        const table = { entry, span: [t0, t1], channels: lanes.map(({ channel }) => channel) };
        throw new Error(`${entry.name}: this page cannot copy the packets: ${error.message}. Repair a damaged file with hapfmt recover. Then use: ${this.command('subset', table, name)}`);
      });
      if (!part.packets) {
        saved.push(`${name} was not saved: the selection has no packet of these channels.`);
        continue;
      }
      download(new Blob([part.bytes], { type: 'haptics/vnd.hapf' }), name);
      const along = part.channels.length - channels.length;
      const text = along > 0 ? ` ${plural(along, 'channel')} came along, coded in one track with others.` : '';
      saved.push(`Saved ${name}, ${plural(part.packets, 'packet')}, ${formatBytes(part.bytes.length)}: ${edge(part.start)} to ${edge(part.stop)} s.${text}${part.notes.map((note) => ` ${note}`).join('')}`);
    }
    return saved.join(' ');
  }

  // What does the same on a command line.
  command(verb, { entry, span: [t0, t1], channels }, out) {
    const numbers = channels.map(({ index }) => index).join(',');
    return `hapfmt ${verb} ${quoted(entry.name)} ${quoted(out)} --channels ${numbers} --start ${t0} --stop ${t1}`;
  }
}
