// What the verb `decode` writes: decode.json and the files of numbers, 8 bytes each, little-endian.
import { channelsOf } from '../../../hapfmt/viewer/decoder/channels.js';
import { hex, sha256 } from '../../../hapfmt/viewer/decoder/sha256.js';
import { physicalValue } from '../../../hapfmt/viewer/decoder/values.js';

const BLOCK = 65536;

// Calls put(view, i, at) for each of `length` numbers, block by block, and gives the bytes.
function* blocks(length, put) {
  for (let from = 0; from < length; from += BLOCK) {
    const n = Math.min(BLOCK, length - from);
    const bytes = new Uint8Array(8 * n);
    const view = new DataView(bytes.buffer);
    for (let i = 0; i < n; i++) put(view, 8 * i, from + i);
    yield bytes;
  }
}

function* rawNumbers(numbers) {
  if (numbers instanceof Int32Array) {
    yield* blocks(numbers.length, (view, at, i) => {
      view.setInt32(at, numbers[i], true);
      view.setInt32(at + 4, numbers[i] >> 31, true);
    });
  } else if (numbers instanceof BigUint64Array) {
    yield* blocks(numbers.length, (view, at, i) => view.setBigUint64(at, numbers[i], true));
  } else {
    yield* blocks(numbers.length, (view, at, i) => view.setUint32(at, numbers[i], true));
  }
}

function* rawPhysical(counts, calibration) {
  yield* blocks(counts.length, (view, at, i) => view.setFloat64(at, physicalValue(calibration, counts[i]), true));
}

function* rawTrack(entry) {
  for (const { numbers } of entry.pieces) yield* rawNumbers(numbers);
}

function* rawChannel(channel) {
  for (const part of channel.parts) yield* rawNumbers(part.numbers());
}

function* rawChannelPhysical(channel, calibration) {
  for (const part of channel.parts) yield* rawPhysical(part.numbers(), calibration);
}

function* rawChannelExact(channel, calibration) {
  for (const part of channel.parts) {
    if (part.isExact) yield* rawNumbers(part.exact());
    else yield* rawPhysical(part.numbers(), calibration);
  }
}

const textOf = (number) => (number === null ? null : String(number));

function headOf(head) {
  if (head === null) return null;
  return {
    major: head.major, minor: head.minor, level: head.level, file_id: head.fileId, uuid: hex(head.uuid),
    epoch_ns: textOf(head.epochNs), epoch_uncertainty_ns: textOf(head.epochUncertaintyNs),
  };
}

const PLAIN = { A: 1, B: 0, D: 1 };

function describeChannel({ channel, track, component, spans }) {
  const words = track.numberFormat !== 'counts';
  const { A, B, D } = words ? PLAIN : track.calibrations[component] ?? PLAIN;
  return {
    channel, label: track.labels[component] ?? '', unit: track.units[component] ?? '1',
    quantity: track.quantities[component] ?? '', axis: track.axes[component] ?? '',
    group: track.groups[component] ?? '', body_site: track.bodySites[component] ?? '',
    device: track.devices[component] ?? '', rate: [track.rateNum, track.rateDen], calibration: [A, B, D], spans,
  };
}

// -> { json: text, raw: Map file name -> iterable of Uint8Array }
export function decodeOutput(file, decoded) {
  const raw = new Map();
  const { channels, lf, hf } = channelsOf(file, decoded);
  const store = (name, bytes) => {
    raw.set(name, bytes);
    return name;
  };
  const report = { head: headOf(file.head), tracks: [], channels: [], lf: [], hf: [], layers: [] };

  for (const entry of decoded.tracks.values()) {
    const { track } = entry;
    const { id, kind, codec, rateNum, rateDen } = track;
    if (track.unsupported) continue;
    if (kind === 'events') {
      const events = entry.events.map(({ tick, duration, channel, text }) => [tick, duration, channel, text]);
      report.layers.push({ track: id, label: track.labels[0] ?? '', rate: [rateNum, rateDen], events });
      continue;
    }
    report.tracks.push({
      track: id, kind, codec, number_format: track.numberFormat, component_count: track.componentCount,
      rate: [rateNum, rateDen], spans: entry.spans, numbers: store(`track-${id}.raw`, rawTrack(entry)),
    });
  }

  for (const channel of channels) {
    const { channel: number, track } = channel;
    const described = describeChannel(channel);
    described.numbers = store(`channel-${number}.raw`, rawChannel(channel));
    if (track.numberFormat === 'counts') {
      const calibration = track.calibrations[channel.component] ?? PLAIN;
      described.physical = store(`channel-${number}.physical`, rawChannelPhysical(channel, calibration));
      if (channel.parts.some((part) => part.isExact)) {
        described.exact = store(`channel-${number}.exact`, rawChannelExact(channel, calibration));
      }
    }
    report.channels.push(described);
  }
  for (const [band, list] of [['lf', lf], ['hf', hf]]) {
    for (const channel of list) {
      const { channel: number, spans } = channel;
      if (spans.length === 0) continue;
      report[band].push({ channel: number, spans, numbers: store(`${band}-${number}.raw`, rawChannel(channel)) });
    }
  }

  report.clocks = file.clocks.map(({ track, name, observations }) => ({
    track, name,
    observations: observations.map(({ tick, timeNs, uncertaintyNs }) => [tick, String(timeNs), String(uncertaintyNs)]),
  }));
  report.maps = file.maps.map(({ track, name, points }) => ({
    track, name, points: points.map(({ tick, timeNs }) => [tick, String(timeNs)]),
  }));
  report.metadata = file.metadata;
  report.attachments = file.attachments.map(({ name, mediaType, content }) => ({
    name, media_type: mediaType, size: content.length, sha256: hex(sha256(content)),
  }));
  report.unknown = file.unknown;
  return { json: toJson(report, file.metadataText), raw };
}

// Metadata are given as they are stored, where openFile kept their text: their numbers may have any number of digits.
function toJson(report, metadataText) {
  if (metadataText === undefined || metadataText === null) return JSON.stringify(report);
  const { metadata, ...others } = report;
  return `${JSON.stringify(others).slice(0, -1)},"metadata":${metadataText}}`;
}
