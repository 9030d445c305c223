// Findings as the page shows them: when, of which channels, and what.
import { secondsAt } from './ticks.js';

const SHOWN = 2 ** 16;

// A packet that does not decode.
export function faultOf(file, { track, start, stop, offset, size, error }) {
  return {
    time0: secondsAt(track, start), time1: secondsAt(track, stop), channels: [...track.channels], code: 'bad-packet',
    requirement: error.requirement, message: error.message, offset, size,
  };
}

// The damage of a file that was walked through, and the rules that it breaks. time1 is null where the end is not known.
export function damagesOf(file) {
  const found = [];
  const add = ({ code, requirement, message, offset, size }, spans) => {
    if (!spans.length) found.push({ time0: null, time1: null, channels: null, code, requirement, message, offset, size });
    for (const { track: id, start, stop } of spans) {
      const track = file.tracks.get(id); // no channel needs a track that was left out
      found.push({
        time0: track ? secondsAt(track, start) : null, time1: track && stop !== null ? secondsAt(track, stop) : null,
        channels: track ? [...track.channels] : [], code, requirement, message, offset, size,
      });
    }
  };
  for (const damage of file.damages) {
    if (found.length > SHOWN) break;
    add(damage, damage.took ?? []);
  }
  if (file.lost.length) {
    add({ code: 'lost-residual', requirement: 'DEC-003', message: 'the HF track is lost', offset: null, size: null }, file.lost);
  }
  const told = new Set(file.damages.flatMap(({ packet, chunk }) => [packet, chunk]));
  for (const { kind, requirement, message, offset, packet, chunk } of file.findings) {
    if (found.length > SHOWN) break;
    if ((packet && told.has(packet)) || (!packet && chunk && told.has(chunk))) continue;
    const spans = packet ? [{ track: packet.track, start: packet.start, stop: packet.start + packet.span }] : [];
    add({ code: kind === 'unsupported' ? 'unsupported' : 'nonconforming', requirement, message, offset, size: packet?.size ?? null }, spans);
  }
  return found;
}
