// All descriptions of a file together: the rules of 6.3 that concern more than one track.
import { HapfError } from './error.js';
import { limitDescriptions, readTrak } from './trak.js';
import { checkCalibration } from './values.js';

const sameBytes = (a, b) => a.length === b.length && a.every((byte, i) => byte === b[i]);
const sameRate = (a, b) => BigInt(a.rateNum) * BigInt(b.rateDen) === BigInt(b.rateNum) * BigInt(a.rateDen);
const sameList = (a, b) => a.length === b.length && a.every((v, i) => v === b[i]);
const sameCalibrations = (a, b) => a.every((v, i) => v.A === b[i].A && v.B === b[i].B && v.D === b[i].D);

// -> { descriptions, tracks, allTracks, lostBases, lostResiduals }. `note(error, chunk, soft)` takes what breaks a rule;
// soft: what is not held against a file with damage (14.1). In `tracks` are those that are used, in `allTracks`
// all that were described.
export function describeTracks(bytes, chunks, level, damaged, note) {
  const descriptions = readAll(bytes, chunks, level, note);
  const allTracks = new Map();
  for (const one of descriptions) for (const track of one.tracks) allTracks.set(track.id, track);
  const sorted = [...allTracks.values()].sort((a, b) => a.id - b.id);
  const tracks = new Map(sorted.filter((track) => !track.fault).map((track) => [track.id, track]));
  const context = { tracks, allTracks, damaged, note };
  linkBases(context);
  linkContinued(context);
  checkChannels(context);
  linkChains(tracks);
  const lostBases = [...tracks.values()].filter((track) => track.baseLost);
  const lostResiduals = [...tracks.values()].filter((track) => track.kind === 'lf' && !track.hf && !track.strange);
  return { descriptions, tracks, allTracks, lostBases, lostResiduals };
}

function readAll(bytes, chunks, level, note) {
  const byId = new Map();
  const descriptions = [];
  let weight = 0;
  for (const chunk of chunks) {
    const payload = bytes.subarray(chunk.payloadStart, chunk.end);
    const known = byId.get(chunk.track);
    if (known) {
      const copy = known.firstId === chunk.track && sameBytes(known.payload, payload);
      if (!copy) note(new HapfError('broken', 'TRK-003', `track ${chunk.track} is described otherwise`, chunk.position), chunk);
      continue;
    }
    const { description, faults } = readTrak(bytes, chunk, level);
    for (const fault of faults) note(fault, chunk);
    if (!description) {
      byId.set(chunk.track, { firstId: chunk.track, payload });
      continue;
    }
    if (description.tracks.some(({ id }) => byId.has(id))) {
      note(new HapfError('broken', 'TRK-003', 'a track is described twice', chunk.position), chunk);
      continue;
    }
    weight += description.weight;
    limitDescriptions(weight, chunk.position);
    description.index = descriptions.length;
    descriptions.push(description);
    for (const { id } of description.tracks) byId.set(id, description);
  }
  return descriptions;
}

// Whether a track is described after another one.
const isLater = (a, b) => a.description.index > b.description.index || (a.description === b.description && a.id > b.id);

// TRK-007, TRK-012; calibrations of a residual are those of its base.
function linkBases({ tracks, allTracks, damaged, note }) {
  for (const track of tracks.values()) {
    if (track.kind !== 'hf' || track.strange) continue;
    const { chunk } = track.description;
    const fault = (message, soft) => note(new HapfError('broken', 'TRK-007', message, chunk.payloadStart), chunk, soft);
    const base = tracks.get(track.base);
    if (!base) {
      if (!damaged) fault(`base ${track.base} of track ${track.id} is not described`, true);
      track.baseLost = true;
      continue;
    }
    if (base.strange) continue;
    if (isLater(base, track)) fault(`base ${track.base} of track ${track.id} is not described before it`, true);
    const fits = base.kind === 'lf' && base.componentCount === track.componentCount && sameRate(base, track)
      && base.channels[0] === track.channels[0];
    if (!fits || base.hf) {
      fault(`base ${track.base} does not fit track ${track.id}`);
      tracks.delete(track.id);
      track.left = 'TRK-007';
      continue;
    }
    base.hf = track;
    track.calibrations = base.calibrations;
    for (const name of ['labels', 'units', 'quantities', 'axes', 'groups', 'bodySites', 'devices']) track[name] = base[name];
    for (const calibration of new Set(base.calibrations)) {
      try {
        checkCalibration(calibration, base, track, base.description.chunk.payloadStart);
      } catch (error) {
        note(error, base.description.chunk);
        tracks.delete(track.id);
        track.left = 'VAL-001';
        base.hf = null;
        break;
      }
    }
  }
  for (const track of allTracks.values()) {
    if (track.kind === 'lf' && !track.hf && !track.strange) {
      note(new HapfError('broken', 'TRK-012', `track ${track.id} of kind LF is the base of none`, track.description.chunk.position), track.description.chunk, 'closed');
    }
  }
}

function fits(track, other) {
  return (other.kind === 'full' || other.kind === 'lf') && other.id < track.id
    && other.componentCount === track.componentCount && sameList(other.channels, track.channels) && sameRate(other, track)
    && other.numberFormat === track.numberFormat && sameCalibrations(other.calibrations, track.calibrations)
    && sameList(other.units, track.units);
}

// With its HF track, which has no channel without it.
function leaveOut(tracks, track, requirement) {
  for (const one of track.hf ? [track, track.hf] : [track]) {
    tracks.delete(one.id);
    one.left = requirement;
  }
}

// TRK-016. Where the track between two is lost, they stay one channel (14.1).
function linkContinued({ tracks, damaged, note }) {
  const leave = (track, message) => {
    note(new HapfError('broken', 'TRK-016', message, track.description.chunk.position), track.description.chunk);
    leaveOut(tracks, track, 'TRK-016');
  };
  for (const track of tracks.values()) {
    if (track.strange || track.continues === null) continue;
    const other = tracks.get(track.continues);
    if (other?.strange) continue;
    if (!other) {
      if (!damaged) {
        note(new HapfError('broken', 'TRK-016', `track ${track.continues} is not described`, track.description.chunk.position), track.description.chunk);
      }
      const left = lastOfChannel(tracks, track);
      if (left && !fits(track, left)) leave(track, `track ${track.id} does not fit track ${left.id}`);
      else track.continues = left ? left.id : null;
      if (left && !track.left) left.continuedBy = track;
      continue;
    }
    if (isLater(other, track)) {
      note(new HapfError('broken', 'TRK-016', `track ${other.id} is not described before`, track.description.chunk.position), track.description.chunk, true);
    }
    if (!fits(track, other)) leave(track, `track ${track.id} does not fit track ${other.id}`);
    else if (other.continuedBy) leave(track, `a second track continues track ${other.id}`);
    else other.continuedBy = track;
  }
}

function lastOfChannel(tracks, track) {
  let last = null;
  for (const other of tracks.values()) {
    if (other !== track && other.kind !== 'hf' && other.channels[0] === track.channels[0] && other.id < track.id
      && !other.continuedBy) last = other;
  }
  return last;
}

// TRK-010.
function checkChannels({ tracks, allTracks, damaged, note }) {
  const owners = new Map();
  for (const track of [...tracks.values()]) {
    if (track.strange || track.kind === 'hf' || track.kind === 'events') continue;
    const taken = track.channels.find((channel) => owners.has(channel));
    if (taken === undefined) {
      for (const channel of track.channels) owners.set(channel, track);
      continue;
    }
    if (track.continues !== null) continue;
    note(new HapfError('broken', 'TRK-010', `channel ${taken} twice`, track.description.chunk.payloadStart), track.description.chunk);
    leaveOut(tracks, track, 'TRK-010');
  }
  const complete = ![...allTracks.values()].some((track) => track.strange);
  let next = 0;
  while (owners.has(next)) next++;
  if (owners.size > next && complete && !damaged) {
    const after = [...owners.entries()].filter(([channel]) => channel > next).sort((a, b) => a[0] - b[0])[0];
    const { chunk } = after[1].description;
    note(new HapfError('broken', 'TRK-010', `no channel ${next}, but channel ${after[0]}`, chunk.payloadStart), chunk, 'closed');
  }
}

// Tracks that continue one another have one `chain`; their HF tracks another one.
function linkChains(tracks) {
  for (const track of tracks.values()) {
    const before = track.continues === null ? null : tracks.get(track.continues);
    track.chain = before && before.chain !== undefined ? before.chain : track.id;
  }
  for (const track of tracks.values()) {
    const base = track.kind === 'hf' && tracks.get(track.base);
    if (base) track.chain = `hf ${base.chain}`;
  }
}
