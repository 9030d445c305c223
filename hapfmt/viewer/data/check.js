// A full check of a file. It takes long, so the page gives it a Worker of its own.
import { reportOf } from '../decoder/report.js';
import { verifyFile } from '../decoder/verify.js';
import { readWhole } from './bywalk.js';
import { damagesOf } from './damages.js';
import { openSource } from './sources.js';

const TELL_MS = 100;

// onProgress(done, of): of the reading and, as much again, of the decoding. -> { verdict, damages, channels, findings }.
export async function checkFile(place, onProgress) {
  const source = await openSource(place);
  const { size } = source;
  const bytes = await readWhole(source, (done) => onProgress(done, 2 * size));
  let told = performance.now();
  const file = verifyFile(bytes, {
    onProgress(done, of) {
      if (performance.now() - told < TELL_MS) return;
      told = performance.now();
      onProgress(size + (size * done) / of, 2 * size);
    },
  });
  const { verdict, damages, channels, findings } = reportOf(file);
  return { verdict, damages: damagesOf(file), channels, findings: [...damages, ...findings] };
}
