// TRAK chunks that a recoverer writes (docs/spec/recovery.md): tracks that it keeps, and those that it makes up.
import { putVarint } from './bytes.js';
import { putTlv } from './head.js';
import { limitsOf } from './limits.js';
import { recordLinked } from './trak.js';

const KINDS = { full: 0, hf: 2 };
const LOST = '(lost)';

function strings(list) {
  const out = [];
  for (const text of list) {
    const bytes = new TextEncoder().encode(text);
    out.push(bytes.length, ...bytes);
  }
  return out;
}

// A track as the payload of TRAK has it.
function recordOf(track, tlvs) {
  const bytes = [KINDS[track.kind], ...new TextEncoder().encode(track.codec), track.componentCount];
  const linked = track.base === null ? 0 : 1 + track.base;
  for (const number of [track.rateNum, track.rateDen, 0, 0, track.channel, linked]) putVarint(bytes, number);
  bytes.push(tlvs.length);
  for (const [type, value] of tlvs) putTlv(bytes, type, value);
  return Uint8Array.from(bytes);
}

const KNOT_PARAMETERS = [0, 0, 0, 1, 0];

function emptyTrack(id, kind, componentCount, [rateNum, rateDen], channel, base, tlvs) {
  const track = { kind, componentCount, rateNum, rateDen, base, codec: 'KNOT', channel };
  return { id, componentCount, record: recordOf(track, [[1, KNOT_PARAMETERS], ...tlvs]) };
}

const HEAD_ROOM = 4;

// The payloads of TRAK for tracks in this order: { payload, ids }.
export function payloadsOf(list, bound) {
  const out = [];
  let last = null;
  for (const { id, componentCount, record } of list) {
    const fits = last && id === last.ids.at(-1) + 1 && last.components + componentCount <= 255 && last.size + record.length <= bound;
    if (!fits) {
      last = { ids: [], records: [], components: 0, size: HEAD_ROOM };
      out.push(last);
    }
    last.ids.push(id);
    last.records.push(record);
    last.components += componentCount;
    last.size += record.length;
  }
  return out.map(({ ids, records }) => {
    const start = [];
    putVarint(start, ids[0]);
    start.push(0);
    const payload = new Uint8Array(records.reduce((sum, record) => sum + record.length, start.length));
    payload.set(start);
    let at = start.length;
    for (const record of records) {
      payload.set(record, at);
      at += record.length;
    }
    return { payload, ids };
  });
}

// REC-007: -> [{ payload, ids }], each base and each track that is continued before those that need it.
export function descriptionsOf(file) {
  const kept = new Set();
  for (const track of file.allTracks.values()) {
    if (!track.fault && !track.left && !track.baseLost) kept.add(track.id);
  }
  const before = [];
  const residuals = [];
  for (const track of file.allTracks.values()) {
    if (!kept.has(track.id)) continue;
    const same = track.strange || track.kind === 'hf' || track.continues === track.continuesAsRead;
    const record = same ? track.record : recordLinked(track, track.channels, track.continues);
    (track.kind === 'hf' ? residuals : before).push({ id: track.id, componentCount: track.componentCount, record });
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
  const byId = (a, b) => a.id - b.id;
  const all = [...before.sort(byId), ...residuals.sort(byId)];
  return { descriptions: payloadsOf(all, limitsOf(file.level).payloadBound), kept };
}

function addLostChannels(file, kept, newId, list) {
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
