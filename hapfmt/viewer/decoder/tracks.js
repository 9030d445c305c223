// All descriptions of a file together: the rules of 6.3 that concern more than one track.
import { HapfError } from './error.js';
import { firstTrackOf, limitDescriptions, readTrak } from './trak.js';
import { checkCalibration } from './values.js';

const sameBytes = (a, b) => a.length === b.length && a.every((byte, i) => byte === b[i]);
const sameRate = (a, b) => BigInt(a.rateNum) * BigInt(b.rateDen) === BigInt(b.rateNum) * BigInt(a.rateDen);
const sameList = (a, b) => a.length === b.length && a.every((v, i) => v === b[i]);
const sameCalibrations = (a, b) => a.every((v, i) => v.A === b[i].A && v.B === b[i].B && v.D === b[i].D);

// -> { descriptions, tracks, allTracks, lostBases, lostResiduals }. `note(error, chunk, soft)` takes what breaks a rule;
// soft: what is not held against a file with damage (14.2). In `tracks` are those that are used, in `allTracks`
// all that were described.
export function describeTracks(bytes, chunks, level, damaged, note) {
  const descriptions = readAll(bytes, chunks, level, note);
  const allTracks = new Map();
  for (const one of descriptions) for (const track of one.tracks) allTracks.set(track.id, track);
  const sorted = [...allTracks.values()].sort((a, b) => a.id - b.id);
  const tracks = new Map(sorted.filter((track) => !track.fault).map((track) => [track.id, track]));
  const context = { tracks, allTracks, damaged, note };
  linkContinued(context);
  linkBases(context);
  linkChains(tracks);
  const lostBases = [...tracks.values()].filter((track) => track.baseLost);
  const lostResiduals = [...tracks.values()].filter(lacksResidual);
  return { descriptions, tracks, allTracks, lostBases, lostResiduals };
}

function readAll(bytes, chunks, level, note) {
  const byId = new Map();
  const descriptions = [];
  let weight = 0;
  for (const chunk of chunks) {
    const payload = bytes.subarray(chunk.payloadStart, chunk.end);
    chunk.track = firstTrackOf(payload);
    const known = byId.get(chunk.track);
    if (known) {
      const copy = known.firstId === chunk.track && sameBytes(known.payload, payload);
      if (!copy) note(new HapfError('broken', 'TRK-003', `track ${chunk.track} is described otherwise`, chunk.position), chunk);
      continue;
    }
    const { description, faults } = readTrak(bytes, chunk, level);
    for (const fault of faults) note(fault, chunk);
    if (!description) {
      if (chunk.track !== null) byId.set(chunk.track, { firstId: chunk.track, payload });
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

const lacksResidual = (track) => track.kind === 'lf' && !track.hf && !track.strangeHf && !track.strange;

// TRK-007, TRK-012; calibrations of a residual are those of its base.
function linkBases({ tracks, allTracks, damaged, note }) {
  for (const track of tracks.values()) {
    if (track.kind !== 'hf') continue;
    if (track.strange) {
      if (tracks.has(track.base)) tracks.get(track.base).strangeHf = true;
      continue;
    }
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
        note(error, chunk);
        tracks.delete(track.id);
        track.left = 'VAL-001';
        base.hf = null;
        break;
      }
    }
  }
  for (const track of allTracks.values()) {
    if (lacksResidual(track)) {
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

// What a track is to others where it is lost, left out or not supported: not there.
const known = (tracks, id) => (tracks.get(id)?.strange ? undefined : tracks.get(id));

// TRK-010, TRK-016: each track fits those that are left with smaller ids. Where the track between two is lost, they stay
// one channel (14.2).
function linkContinued({ tracks, allTracks, damaged, note }) {
  const owners = new Set(); // the channel numbers of all tracks, and of those that are supported
  const supported = new Set();
  const last = new Map(); // by first channel
  for (const track of [...tracks.values()]) {
    if (track.kind === 'hf' || track.kind === 'events') continue;
    const { chunk } = track.description;
    const fault = (requirement, message, soft) => note(new HapfError('broken', requirement, message, chunk.payloadStart), chunk, soft);
    const left = last.get(track.firstChannel);
    const other = known(tracks, track.continues);
    let wrong = null;
    if (track.strange) {
      if (track.continues === null && track.channels.some((c) => owners.has(c))) wrong = 'TRK-010';
    } else if (left && track.continues !== null) {
      if ((other && other !== left) || !fits(track, left)) wrong = 'TRK-016';
    } else if (other) {
      wrong = 'TRK-016';
    } else {
      const taken = track.continues === null ? owners : supported;
      if (track.channels.some((c) => taken.has(c))) wrong = 'TRK-010';
    }
    if (wrong) {
      fault(wrong, wrong === 'TRK-010' ? `a channel of track ${track.id} twice` : `track ${track.id} cannot continue track ${track.continues}`);
      tracks.delete(track.id);
      track.left = wrong;
      continue;
    }
    for (const channel of track.channels) owners.add(channel);
    if (track.strange) continue;
    if (track.continues !== null) {
      if (!tracks.has(track.continues)) fault('TRK-016', `track ${track.continues} is not described`, true);
      if (other && isLater(other, track)) fault('TRK-016', `track ${other.id} is not described before`, true);
      if (!tracks.has(track.continues)) track.continues = left ? left.id : null;
    }
    for (const channel of track.channels) supported.add(channel);
    track.before = track.continues === null ? null : left ?? null;
    last.set(track.firstChannel, track);
  }
  checkHoles(owners, allTracks, damaged, note);
}

// TRK-010.
function checkHoles(owners, allTracks, damaged, note) {
  let next = 0;
  while (owners.has(next)) next++;
  if (owners.size <= next || damaged) return;
  const track = [...allTracks.values()].find(({ channels }) => channels.some((channel) => channel > next));
  const { chunk } = track.description;
  note(new HapfError('broken', 'TRK-010', `no channel ${next}, but a higher one`, chunk.payloadStart), chunk, 'closed');
}

// Tracks that continue one another have one `chain`; their HF tracks another one.
function linkChains(tracks) {
  for (const track of tracks.values()) {
    track.chain = track.before?.chain ?? track.id;
  }
  for (const track of tracks.values()) {
    const base = track.kind === 'hf' && tracks.get(track.base);
    if (base) track.chain = `hf ${base.chain}`;
  }
}
