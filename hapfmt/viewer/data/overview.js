// The overview of a file (docs/spec/overview.md): lowest and highest values by bins, read part by part.
import { Reader } from '../decoder/bytes.js';
import { HEADER_SIZE } from '../decoder/chunk.js';
import { crc32 } from '../decoder/crc32.js';
import { HapfError } from '../decoder/error.js';
import { inflate } from '../decoder/inflate.js';
import { Lru } from './lru.js';

const MAGIC = 'hOVW';
const END_SIZE = 40;
const CHANNEL_SIZE = 36;
const PART_SIZE = 8;
const FACTOR = 8;
const COARSEST = 1024; // bins of the coarsest level, at most
const BLOCK = 4096; // bins of a part
const BASE_BOUND = 2 ** 24;
const TICK_BOUND = 2 ** 48;
const EMPTY = -32768;
const KEPT = 2 ** 24; // bytes of decoded parts
const BIN_BYTES = 16;
const TRIED = 16; // attachments, from the last one on

// The overview breaks a rule: it counts as absent (OVW-007).
export class BadOverview extends Error {}

const need = (holds) => {
  if (!holds) throw new BadOverview();
};

// -> Overview, or null where the file has none.
export async function findOverview(source, file) {
  for (const { offset, stop } of file.attachments.slice(-TRIED).reverse()) {
    try {
      return await readOverview(source, file, offset, stop);
    } catch (error) {
      if (!(error instanceof BadOverview)) throw error;
    }
  }
  return null;
}

// start, stop: of the chunk of the attachment. Name and media type need not be read.
async function readOverview(source, file, start, stop) {
  const at = stop - END_SIZE;
  need(at >= start + HEADER_SIZE);
  const end = await source.read(at, stop);
  const reader = new Reader(end);
  const fileId = reader.u64();
  const covered = Number(reader.u64());
  const [base, channelCount, partCount, tableCrc] = [reader.u32(), reader.u32(), reader.u32(), reader.u32()];
  need(String.fromCharCode(...reader.bytes(4)) === MAGIC && reader.u32() === crc32(end, 0, END_SIZE - 4));
  need(fileId === BigInt(file.fileId) && covered <= start);
  need(base >= 1 && base <= BASE_BOUND && (base & (base - 1)) === 0);
  const size = CHANNEL_SIZE * channelCount + PART_SIZE * partCount;
  need(size <= at - start - HEADER_SIZE);
  const table = await source.read(at - size, at);
  need(crc32(table) === tableCrc);
  const rows = readRows(table, channelCount, base, file);
  const parts = readParts(table.subarray(CHANNEL_SIZE * channelCount), rows, at - size, start + HEADER_SIZE);
  return new Overview(source, { covered, base, rows, parts });
}

// OVW-003.
function readRows(table, count, base, file) {
  const reader = new Reader(table);
  const channels = new Set([...file.tracks.values()].flatMap((track) => track.channels));
  const rows = [];
  let last = -1;
  for (let i = 0; i < count; i++) {
    const channel = reader.u32();
    const [first, ticks] = [Number(reader.u64()), Number(reader.u64())];
    const view = new DataView(reader.bytes(16).slice().buffer);
    const [low, high] = [view.getFloat64(0, true), view.getFloat64(8, true)];
    need(channel > last && channels.has(channel) && first + ticks <= TICK_BOUND);
    need(Number.isFinite(low) && Number.isFinite(high) && low <= high);
    const row = { channel, place: i, first, ticks, low, high, levels: [] };
    for (let size = base; ticks; size *= FACTOR) {
      const bin = Math.floor(first / size);
      const bins = Math.floor((first + ticks - 1) / size) - bin + 1;
      row.levels.push({ size, bin, bins, parts: [] });
      if (bins <= COARSEST) break;
    }
    rows.push(row);
    last = channel;
  }
  return rows;
}

// OVW-003; gives each level its parts. lowest: where the content begins at the earliest.
function readParts(rest, rows, stop, lowest) {
  const count = rest.length / PART_SIZE;
  let expected = 0;
  for (const { levels } of rows) for (const { bins } of levels) expected += Math.ceil(bins / BLOCK);
  need(expected === count);
  const parts = [];
  for (const { place, levels } of rows) {
    levels.forEach((level, k) => {
      for (let block = 0; block * BLOCK < level.bins; block++) {
        const part = { order: k - levels.length, block, place, bins: Math.min(BLOCK, level.bins - block * BLOCK) };
        level.parts.push(part);
        parts.push(part);
      }
    });
  }
  parts.sort((a, b) => a.order - b.order || a.block - b.block || a.place - b.place);
  const reader = new Reader(rest);
  let size = 0;
  for (const part of parts) {
    part.size = reader.u32();
    part.crc = reader.u32();
    need(part.size >= 1);
    size += part.size;
  }
  let offset = stop - size;
  need(offset >= lowest);
  for (const part of parts) {
    part.offset = offset;
    offset += part.size;
  }
  return parts;
}

class Overview {
  constructor(source, { covered, base, rows, parts }) {
    this.source = source;
    this.covered = covered;
    this.base = base;
    this.rows = new Map(rows.map((row) => [row.channel, row]));
    this.parts = parts;
    this.kept = new Lru(KEPT);
  }

  // The coarsest level of a channel with bins of at most two `width` ticks, the finest if there is none.
  levelFor(row, width) {
    let found = row.levels[0];
    for (const level of row.levels) if (level.size <= 2 * width) found = level;
    return found;
  }

  // Bytes to fetch for load(wanted), 0 where there are too many to be kept.
  missingBytes(wanted) {
    let [size, bins] = [0, 0];
    for (const one of wanted) {
      for (const part of partsOf(one)) {
        bins += part.bins;
        if (!this.kept.get(part)) size += part.size;
      }
    }
    return BIN_BYTES * bins > KEPT / 2 ? 0 : size;
  }

  // The parts that ranges need in one go: wanted is [{ row, level, first, stop }], in ticks.
  async load(wanted, signal) {
    const missing = [];
    for (const one of wanted) for (const part of partsOf(one)) if (!this.kept.get(part)) missing.push([one.row, part]);
    const read = await this.source.readAll(missing.map(([, { offset, size }]) => [offset, offset + size]), signal);
    const held = new Map();
    missing.forEach(([row, part], i) => {
      need(crc32(read[i]) === part.crc);
      const values = decodePart(read[i], part, row);
      held.set(part, values);
      this.kept.set(part, values, BIN_BYTES * part.bins);
    });
    return (part) => held.get(part) ?? this.kept.get(part);
  }
}

function partsOf({ level, first, stop }) {
  const a = Math.max(Math.floor(first / level.size) - level.bin, 0);
  const b = Math.min(Math.floor((stop - 1) / level.size) - level.bin, level.bins - 1);
  return level.parts.slice(Math.floor(a / BLOCK), Math.floor(Math.max(b, -1) / BLOCK) + 1);
}

// OVW-003.
function decodePart(bytes, { bins, offset }, { low, high }) {
  let raw;
  try {
    raw = inflate(bytes, 4 * bins, offset, 'OVW-003');
  } catch (error) {
    if (!(error instanceof HapfError)) throw error;
    throw new BadOverview();
  }
  const middle = low / 2 + high / 2;
  const step = (high / 2 - low / 2) / 32767;
  const valueOf = (q) => {
    if (q === -32767) return low;
    if (q === 32767) return high;
    return Math.min(Math.max(middle + q * step, low), high);
  };
  const min = new Float64Array(bins).fill(NaN);
  const max = new Float64Array(bins).fill(NaN);
  let code = 0;
  for (let i = 0; i < bins; i++) {
    code = ((code + raw[i] + 256 * raw[bins + i]) << 16) >> 16;
    const upper = ((code + raw[2 * bins + i] + 256 * raw[3 * bins + i]) << 16) >> 16;
    need(code <= upper && (code === EMPTY) === (upper === EMPTY));
    if (code === EMPTY) continue;
    min[i] = valueOf(code);
    max[i] = valueOf(upper);
  }
  return { min, max };
}

// Bins of `width` ticks, a multiple of the level's, from tick `from` on, a multiple of them.
export function binsOf(held, level, from, width, count) {
  const min = new Float64Array(count).fill(NaN);
  const max = new Float64Array(count).fill(NaN);
  const stop = from + width * count;
  for (const part of partsOf({ level, first: from, stop })) {
    const values = held(part);
    for (let i = 0; i < part.bins; i++) {
      const tick = (level.bin + part.block * BLOCK + i) * level.size;
      if (tick < from || tick >= stop || !(values.min[i] <= values.max[i])) continue;
      const bin = Math.floor((tick - from) / width);
      if (!(min[bin] <= values.min[i])) min[bin] = values.min[i];
      if (!(max[bin] >= values.max[i])) max[bin] = values.max[i];
    }
  }
  return { min, max };
}
