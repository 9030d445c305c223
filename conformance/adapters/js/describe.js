// TRAK chunks that a recoverer writes (12.3): those it keeps, those it takes apart, those it makes up.
import { putSvarint, putVarint } from './bytes.js';
import { NONE } from './trak.js';

const KINDS = { full: 0, lf: 1, hf: 2, events: 3 };
const FORMATS = { counts: 0, int64: 1, uint64: 2, binary16: 3, binary32: 4, binary64: 5 };
const STRINGS = { 2: 'labels', 4: 'units', 6: 'quantities', 8: 'axes', 10: 'groups', 12: 'bodySites', 14: 'devices' };
const LOST = '(lost)';

function strings(list) {
  const out = [];
  for (const text of list) {
    const bytes = new TextEncoder().encode(text);
    out.push(bytes.length, ...bytes);
  }
  return out;
}

function float32(value) {
  return new Uint8Array(new Float32Array([value]).buffer);
}

// The TLVs of one track out of a series of several.
function tlvsOf(track, continues) {
  const { tlvs } = track.series;
  const values = new Map();
  if (track.parameters !== null) values.set(1, track.parameters);
  if (track.kind !== 'hf') {
    for (const [type, name] of Object.entries(STRINGS)) if (tlvs.has(+type)) values.set(+type, strings(track[name]));
    if (tlvs.has(3)) {
      const list = [];
      for (const { A, B, D } of track.calibrations) {
        putSvarint(list, A);
        putSvarint(list, B);
        putVarint(list, D);
      }
      values.set(3, list);
    }
    if (tlvs.has(18)) values.set(18, track.deviations.flatMap(({ declared, largest }) => [...float32(declared), ...float32(largest)]));
  }
  if (continues !== null) {
    const list = [];
    putVarint(list, 1 + continues);
    values.set(11, list);
  }
  if (track.contract) {
    const { kd, kn, vector, guaranteed, floors, zeros } = track.contract;
    const list = [];
    putVarint(list, kd);
    putVarint(list, kn);
    list.push((vector ? 1 : 0) + (guaranteed ? 2 : 0));
    floors.forEach((floor, i) => {
      putVarint(list, floor);
      putSvarint(list, zeros[i]);
    });
    values.set(16, list);
  }
  if (tlvs.has(22)) values.set(22, tlvs.get(22).value);
  return values;
}

function payloadOf(track, tlvs) {
  const fixed = new Uint8Array(28);
  const view = new DataView(fixed.buffer);
  fixed.set([1, track.componentCount, KINDS[track.kind], FORMATS[track.numberFormat]]);
  for (let i = 0; i < 4; i++) fixed[4 + i] = track.codec.charCodeAt(i);
  view.setUint32(8, track.rateNum, true);
  view.setUint32(12, track.rateDen, true);
  view.setInt32(16, track.countMin, true);
  view.setInt32(20, track.countMax, true);
  view.setUint16(24, track.kind === 'events' ? NONE : track.channels[0], true);
  view.setUint16(26, track.base ?? NONE, true);
  const bytes = [...fixed];
  for (const type of [...tlvs.keys()].sort((a, b) => a - b)) {
    const value = tlvs.get(type);
    bytes.push(type & 255, type >> 8, value.length & 255, value.length >> 8, ...value);
  }
  return Uint8Array.from(bytes);
}

const KNOT_PARAMETERS = [0, 0, 0, 1, 0];

function emptyTrack(id, kind, componentCount, [rateNum, rateDen], channel, base, tlvs) {
  const track = {
    kind, componentCount, rateNum, rateDen, base, codec: 'KNOT', numberFormat: 'counts', countMin: 0, countMax: 0, channels: [channel],
  };
  return { track: id, payload: payloadOf(track, new Map([[1, KNOT_PARAMETERS], ...tlvs])), ids: [id] };
}

// REC-007, REC-008: -> [{ track, payload }], each base and each track that is continued before those that need it.
export function descriptionsOf(file) {
  const kept = new Set();
  for (const track of file.allTracks.values()) {
    if (!track.fault && !track.left && !track.baseLost) kept.add(track.id);
  }
  const before = [];
  const residuals = [];
  for (const series of file.series) {
    const tracks = series.tracks.filter(({ id }) => kept.has(id));
    const list = series.kind === 'hf' ? residuals : before;
    const declared = (track) => (series.tlvs.has(11) ? continuedAsRead(track) : null);
    const whole = tracks.length === series.trackCount && (series.unsupported || tracks.every((t) => t.continues === declared(t)));
    if (whole) list.push({ track: series.firstId, payload: series.payload, ids: tracks.map(({ id }) => id) });
    else for (const track of tracks) list.push({ track: track.id, payload: payloadOf(track, tlvsOf(track, track.continues)), ids: [track.id] });
  }
  const taken = new Set([...file.allTracks.keys(), ...file.held.map((packet) => packet.track)]);
  let free = 0;
  const newId = () => {
    while (taken.has(free)) free++;
    taken.add(free);
    return free <= 65533 ? free : null;
  };
  addLostChannels(file, kept, newId, before);
  for (const track of file.lostResiduals) {
    const id = kept.has(track.id) ? newId() : null;
    if (id !== null) residuals.push(emptyTrack(id, 'hf', track.componentCount, [track.rateNum, track.rateDen], track.channels[0], track.id, []));
  }
  const byId = (a, b) => a.track - b.track;
  return { descriptions: [...before.sort(byId), ...residuals.sort(byId)], kept };
}

const continuedAsRead = (track) => track.continuesAsRead ?? null;

function addLostChannels(file, kept, newId, list) {
  if (file.series.some((series) => series.unsupported)) return;
  const there = new Set();
  for (const track of file.allTracks.values()) {
    if (kept.has(track.id) && track.kind !== 'hf') for (const channel of track.channels) there.add(channel);
  }
  const highest = Math.max(-1, ...there.size ? [maximum(there)] : [], ...file.spokenOf?.size ? [maximum(file.spokenOf)] : []);
  for (let channel = 0; channel <= highest;) {
    if (there.has(channel)) {
      channel++;
      continue;
    }
    let count = 0;
    while (count < 255 && channel + count <= highest && !there.has(channel + count)) count++;
    const id = newId();
    if (id !== null) list.push(emptyTrack(id, 'full', count, [1, 1], channel, null, [[2, strings([LOST])]]));
    channel += count;
  }
}

function maximum(set) {
  let highest = -1;
  for (const v of set) if (v > highest) highest = v;
  return highest;
}
