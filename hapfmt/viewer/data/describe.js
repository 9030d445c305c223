// What a file says of itself, and where its channels begin and end.
import { boundText } from './bounds.js';
import { hasBands, isCounted } from './signals.js';
import { secondsAt } from './ticks.js';

const SEARCHED = 64; // clusters from each end that are searched at a time

export async function describe(session) {
  const { file, channels } = session;
  const extents = await extentsOf(session);
  session.extents = extents;
  const described = channels.map((channel) => describeChannel(channel, extents));
  const times = described.filter(({ firstTick, stopTick }) => stopTick > firstTick);
  const { head } = file;
  const ends = [0, 0];
  if (times.length) {
    ends[0] = times.reduce((low, one) => Math.min(low, secondsAt(one.track, one.firstTick)), Infinity);
    ends[1] = times.reduce((high, one) => Math.max(high, secondsAt(one.track, one.stopTick)), 0);
  }
  return {
    size: session.source.size, closed: file.closed, verdict: session.verdict,
    epochNs: head && head.epochNs !== null ? String(head.epochNs) : null, start: ends[0], stop: ends[1], metadata: file.metadata,
    channels: described.map(({ track, ...channel }) => channel), eventTracks: eventTracksOf(file), hasOverview: session.overview !== null,
  };
}

function describeChannel(channel, extents) {
  const { index, track, component, parts } = channel;
  const of = (list) => list[component] ?? '';
  const [firstTick, stopTick] = extents.get(index) ?? [0, 0];
  const codecs = {};
  for (const { base, hf } of parts) {
    codecs[base.kind] ??= base.codec;
    if (hf) codecs.hf ??= hf.codec;
  }
  const { rateNum, rateDen } = track;
  return {
    index, label: of(track.labels), unit: track.units[component] ?? '1', quantity: of(track.quantities), axis: of(track.axes),
    group: of(track.groups), bodySite: of(track.bodySites), device: of(track.devices), rate: rateNum / rateDen,
    rateText: rateDen === 1 ? String(rateNum) : `${rateNum}/${rateDen}`, rateNum, rateDen, firstTick, stopTick,
    numberFormat: track.numberFormat,
    bands: hasBands(channel) ? ['sum', 'lf', 'hf'] : ['sum'], codecs, bound: track.unsupported ?? boundText(channel), deadband: deadbandOf(channel), step: stepOf(channel),
    hasKnots: parts.some(({ base }) => base.codec === 'KNOT'), unsupported: track.unsupported, track,
  };
}

// The distance of stored values that are next to each other, in the unit; null of words and without packets.
function stepOf(channel) {
  const { parts, component } = channel;
  if (!parts.length || !isCounted(channel, 'sum')) return null;
  const { A, D } = parts[0].base.calibrations[component];
  return Math.abs(A / D);
}

// The contract of the full band: that of the HF track where there is one (clause 11).
export function deadbandOf({ parts, component }) {
  for (const { base, hf } of parts) {
    const { contract } = hf ?? base;
    if (!contract) continue;
    const { A, B, D } = base.calibrations[component];
    const { kn, kd, vector, guaranteed, floors, zeros } = contract;
    const floor = Math.abs((floors[vector ? 0 : component] * A) / D);
    return { fraction: kn / kd, kn, kd, floor, zero: (zeros[component] * A + B) / D, vector, guaranteed };
  }
  return null;
}

function eventTracksOf({ tracks }) {
  return [...tracks.values()].filter(({ kind }) => kind === 'events').map(({ id, labels, devices, unsupported }) => ({
    track: id, label: labels[0], device: devices[0], unsupported,
  }));
}

// A channel is in order of time within the file, so its first and its last packet are what counts. Where they are not
// near the ends of the file, the channel is taken to be as long as the file.
async function extentsOf({ channels, packets }) {
  const { clusters } = packets;
  const search = async (numbers, tick) => {
    const found = new Map();
    const missing = new Set(channels.filter(({ parts }) => parts.length));
    for (const some of [numbers.slice(0, 1), numbers.slice(1, SEARCHED)]) {
      if (!missing.size || !some.length) break;
      for await (const table of packets.tablesOf(some)) {
        for (const channel of missing) {
          const ticks = channel.parts.flatMap(({ base }) => (table.get(base.id) ?? []).map(tick));
          if (!ticks.length) continue;
          found.set(channel.index, ticks);
          missing.delete(channel);
        }
      }
    }
    return found;
  };
  const numbers = clusters.map((_, n) => n);
  const firsts = await search(numbers, ({ start }) => start);
  const stops = await search(numbers.reverse(), ({ start, span }) => start + span);
  const least = (list, low) => list.reduce((a, b) => Math.min(a, b), low);
  const most = (list, high) => list.reduce((a, b) => Math.max(a, b), high);
  const extents = new Map();
  for (const { index, parts, track } of channels) {
    if (!parts.length || (clusters.length <= SEARCHED && !firsts.has(index))) continue;
    const tick = (ms) => Math.min((ms * track.rateNum) / track.rateDen / 1000, 2 ** 48);
    extents.set(index, [
      firsts.has(index) ? least(firsts.get(index), Infinity) : Math.floor(tick(least(clusters.map(({ startMs }) => startMs), Infinity))),
      stops.has(index) ? most(stops.get(index), 0) : Math.ceil(tick(most(clusters.map(({ stopMs }) => stopMs), 0))),
    ]);
  }
  return extents;
}
