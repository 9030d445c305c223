// The verdict (clause 13) and the damage report (docs/spec/recovery.md).
import { SIGNATURE } from './chunk.js';
import { findLosses, spanOf } from './lost.js';

export const EXIT_CODES = { intact: 0, nonconforming: 2, damaged: 3, unsupported: 4 };
const NO_LOSS = new Set(['bad-signature', 'other-file', 'out-of-order', 'not-closed']);
const WRITTEN_ANEW = new Set(['iNDX', 'fOOT']);

const merelyOpen = (file) => file.damages.every(({ code }) => code === 'not-closed');
export const breaksRule = (file) => file.findings.some(({ kind }) => kind !== 'unsupported');

// Once all notes are taken: what counts as damage, and what it took. Then digests may be compared, then the verdict.
export function settle(file) {
  if (file.refused) return;
  const notes = file.notes.filter((note) => note.soft !== 'closed' || file.closed);
  file.findings = notes;
  if (file.damaged || file.recovering) rulesAsDamage(file, notes);
  if (!file.closed) {
    const offset = file.bytes.length;
    file.damages.push({ code: 'not-closed', offset, size: 0, requirement: 'FIL-003', message: 'the file was not closed' });
  }
  findLosses(file);
}

// 14.2: in a file with damage, and for a recoverer, rules broken count as damage too.
function rulesAsDamage(file, notes) {
  const seen = new Set();
  for (const { kind, requirement, message, chunk, packet } of notes) {
    const about = packet ?? chunk;
    if (kind !== 'broken' || !about || seen.has(about)) continue;
    seen.add(about);
    if (packet) {
      const code = packet.overlap ? 'overlap' : 'bad-packet';
      const took = packet.overlap ? [] : [spanOf(packet)];
      packet.damage = { code, offset: packet.offset, size: packet.size, requirement, message, took, chunk: packet.chunk, packet };
      file.damages.push(packet.damage);
    } else {
      file.damages.push({ code: 'bad-chunk', offset: chunk.position, size: chunk.end - chunk.position, requirement, message, chunk });
    }
  }
}

export function judge(file) {
  if (file.refused) {
    file.findings = file.notes;
    file.verdict = file.noChunk ? 'nonconforming' : 'unsupported';
  } else if (file.damages.length && !(merelyOpen(file) && breaksRule(file))) file.verdict = 'damaged';
  else if (file.findings.some(({ kind }) => kind === 'unsupported')) file.verdict = 'unsupported';
  else if (file.findings.length) file.verdict = 'nonconforming';
  else file.verdict = 'intact';
  return file.verdict;
}

// Whether a damaged payload was a copy of another one.
const sameContent = (a, b) => a.payloadCrc === b.payloadCrc && a.payloadSize === b.payloadSize;

// Clause 13, of `recover`: what it writes again is not lost.
export function judgeRecovery(file, dropped) {
  const lossless = ({ code, took, chunk, offset, size }) => {
    if (took?.length) return false;
    if (code === 'garbage' && offset + size <= SIGNATURE.length) return true;
    if (NO_LOSS.has(code)) return true;
    if (!chunk || !['bad-chunk', 'bad-payload', 'truncated'].includes(code)) return false;
    if (WRITTEN_ANEW.has(chunk.type)) return true;
    if (chunk.type === 'HEAD') return file.head !== null && chunk !== file.headChunk;
    if (chunk.type === 'TRAK') {
      if (!chunk.intact) return file.descriptions.some((one) => sameContent(one.chunk, chunk));
      return file.allTracks.has(chunk.track) && !file.descriptions.some((one) => one.chunk === chunk);
    }
    // Whatever of its packets is missing has a damage of its own.
    return chunk.type === 'DATA' && code !== 'truncated';
  };
  if (file.refused) return judge(file);
  if (dropped || file.lost.length || !file.damages.every(lossless)) return 'damaged';
  return file.findings.some(({ kind }) => kind === 'unsupported') ? 'unsupported' : 'intact';
}

function seconds(track, tick) {
  if (!track || tick === null) return null;
  const product = tick * track.rateDen;
  if (Number.isSafeInteger(product)) return product / track.rateNum;
  const exact = BigInt(tick) * BigInt(track.rateDen);
  const rate = BigInt(track.rateNum);
  return Number(exact / rate) + Number(exact % rate) / track.rateNum;
}

// No channel needs a track that is left out, such as one whose channels another one has (TRK-010).
const channelsOfTrack = (file, id) => file.tracks.get(id)?.channels ?? [];

function spanJson(file, { track: id, start, stop }) {
  const track = file.tracks.get(id);
  return { track: id, channels: channelsOfTrack(file, id), start, stop, start_s: seconds(track, start), stop_s: seconds(track, stop) };
}

function countBytes(damages) {
  const ranges = damages.map(({ offset, size }) => [offset, offset + size]).sort((a, b) => a[0] - b[0]);
  let count = 0;
  let reached = 0;
  for (const [start, stop] of ranges) {
    count += Math.max(stop - Math.max(start, reached), 0);
    reached = Math.max(reached, stop);
  }
  return count;
}

// The ticks of the full band that are lost at most, null where that is not known.
function lostTicks(spans) {
  let count = 0;
  let reached = 0;
  for (const { start, stop } of spans.sort((a, b) => a.start - b.start)) {
    if (stop === null) return null;
    count += Math.max(stop - Math.max(start, reached), 0);
    reached = Math.max(reached, stop);
  }
  return count;
}

function channelReports(file, spans) {
  const channels = new Map();
  for (const track of file.tracks.values()) {
    if (track.kind === 'hf' || track.kind === 'events') continue;
    track.channels.forEach((channel, component) => {
      if (!channels.has(channel)) channels.set(channel, { label: track.labels[component], track, spans: [] });
    });
  }
  for (const span of spans) {
    for (const channel of channelsOfTrack(file, span.track)) channels.get(channel)?.spans.push(span);
  }
  return [...channels.keys()].sort((a, b) => a - b).map((channel) => {
    const { label, track, spans: lost } = channels.get(channel);
    const ticks = lostTicks(lost);
    return { channel, label, lost_ticks: ticks, lost_s: seconds(track, ticks) };
  });
}

export function reportOf(file, verdict = file.verdict) {
  const damages = file.damages.map(({ code, offset, size, message, requirement, took = [] }) => ({
    code, offset, size, message, requirement, lost: took.map((span) => spanJson(file, span)),
  }));
  const spans = [...file.damages.flatMap(({ took = [] }) => took), ...file.lost];
  return {
    verdict,
    damages,
    lost: file.lost.map((span) => spanJson(file, span)),
    byte_count: countBytes(file.damages),
    channels: file.refused ? [] : channelReports(file, spans),
    findings: file.findings.map(({ requirement, offset, message }) => ({ requirement, offset: offset ?? null, message })),
  };
}
