#!/usr/bin/env node
// The verbs of conformance/README.md. Every verb ends with an exit code of clause 13.
import { closeSync, openSync, readFileSync, writeFileSync, writeSync } from 'node:fs';
import { dirname, join } from 'node:path';
import { createInterface } from 'node:readline';
import { capabilities } from './capabilities.js';
import { checkContracts } from '../../../hapfmt/viewer/decoder/contract.js';
import { decodeFile } from '../../../hapfmt/viewer/decoder/decode.js';
import { encodeJob } from './encode.js';
import { HapfError } from '../../../hapfmt/viewer/decoder/error.js';
import { openFile } from '../../../hapfmt/viewer/decoder/file.js';
import { writeJson } from '../../../hapfmt/viewer/decoder/json.js';
import { decodeOutput } from './output.js';
import { recoverFile } from '../../../hapfmt/viewer/decoder/recover.js';
import { EXIT_CODES, judge, reportOf, settle } from '../../../hapfmt/viewer/decoder/report.js';
import { guarded, noteOf, verifyFile } from '../../../hapfmt/viewer/decoder/verify.js';

const USAGE = `cli.js capabilities
cli.js decode IN OUT
cli.js verify IN OUT.json [--original JOB.json]
cli.js recover IN OUT.hapf REPORT.json [--force]
cli.js encode JOB.json OUT.hapf
cli.js serve`;

class UsageError extends Error {}

function decode([input, folder, ...others]) {
  if (!folder || others.length) throw new UsageError(USAGE);
  const file = openFile(new Uint8Array(readFileSync(input)));
  let decoded = null;
  if (!file.refused) {
    guarded(file, () => {
      decoded = decodeFile(file, { exact: true });
      for (const finding of decoded.findings) {
        finding.packet.broken = true;
        file.notes.push(noteOf(finding, finding.packet));
      }
      settle(file);
    });
  }
  judge(file);
  tellFindings(file);
  if (file.refused || !decoded) return EXIT_CODES[file.verdict];
  // CHK-009: no samples of a file of which a critical part is not understood.
  if (file.criticalUnknown) return EXIT_CODES.unsupported;
  const { json, raw } = decodeOutput(file, decoded);
  for (const [name, blocks] of raw) writeBlocks(join(folder, name), blocks);
  writeFileSync(join(folder, 'decode.json'), json);
  return EXIT_CODES[file.verdict];
}

function writeBlocks(path, blocks) {
  const handle = openSync(path, 'w');
  try {
    for (const block of blocks) {
      for (let at = 0; at < block.length;) at += writeSync(handle, block, at);
    }
  } finally {
    closeSync(handle);
  }
}

function tellFindings(file) {
  for (const { requirement, offset, message } of file.findings.slice(0, 20)) {
    process.stderr.write(`${requirement} at ${offset}: ${message}\n`);
  }
  for (const { code, offset, size, message } of file.damages.slice(0, 20)) {
    process.stderr.write(`${code} at ${offset}, ${size} bytes: ${message}\n`);
  }
}

function verify(args) {
  const place = args.indexOf('--original');
  const original = place >= 0 ? args[place + 1] : null;
  const [input, output, ...others] = place >= 0 ? args.toSpliced(place, 2) : args;
  if (!output || others.length || (place >= 0 && !original)) throw new UsageError(USAGE);
  const file = verifyFile(new Uint8Array(readFileSync(input)));
  let contracts = [];
  let { verdict } = file;
  if (original && !file.refused) {
    contracts = compareOriginal(file, original);
    const failed = contracts.find(({ outside, promised }) => outside > 0 && promised);
    if (failed && verdict === 'intact') verdict = 'damaged';
    for (const { channel, outside, requirement, promised } of contracts) {
      if (outside && promised) file.findings.push({ requirement, offset: null, message: `channel ${channel}: ${outside} samples outside` });
    }
    contracts = contracts.map(({ channel, outside, worst }) => ({ channel, outside, worst }));
  }
  writeFileSync(output, writeJson({ ...reportOf(file, verdict), contracts }));
  return EXIT_CODES[verdict];
}

function compareOriginal(file, path) {
  const job = JSON.parse(readFileSync(path, 'utf8'));
  const sources = job.channels.map(({ numbers }) => {
    const bytes = readFileSync(join(dirname(path), numbers));
    return new BigUint64Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
  });
  return checkContracts(file, job, sources);
}

function recover(args) {
  const force = args.includes('--force');
  const [input, output, reportPath, ...others] = args.filter((arg) => arg !== '--force');
  if (!reportPath || others.length) throw new UsageError(USAGE);
  const { bytes, report, verdict } = recoverFile(new Uint8Array(readFileSync(input)));
  writeFileSync(reportPath, writeJson({ ...report, contracts: [] }));
  // Nothing is overwritten unless the caller asks for it.
  if (bytes) writeFileSync(output, bytes, { flag: force ? 'w' : 'wx' });
  return EXIT_CODES[verdict];
}

function encode([path, output, ...others]) {
  if (!output || others.length) throw new UsageError(USAGE);
  const job = JSON.parse(readFileSync(path, 'utf8'));
  try {
    writeFileSync(output, encodeJob(job, (name) => new Uint8Array(readFileSync(join(dirname(path), name)))));
  } catch (error) {
    if (!(error instanceof HapfError)) throw error;
    process.stderr.write(`${error.message}\n`);
    return EXIT_CODES.unsupported; // a job asks for what this encoder cannot do
  }
  return 0;
}

async function serve() {
  for await (const line of createInterface({ input: process.stdin })) {
    if (line.trim() === '') continue;
    let code = 1;
    try {
      code = await run(JSON.parse(line));
    } catch (error) {
      process.stderr.write(`${error.stack}\n`);
    }
    process.stdout.write(`${code}\n`);
  }
  return 0;
}

const VERBS = { decode, verify, recover, encode, serve };

async function run([verb, ...args]) {
  if (verb === 'capabilities') {
    process.stdout.write(`${JSON.stringify({ ...capabilities, verbs: [...capabilities.verbs, 'serve'] })}\n`);
    return 0;
  }
  if (!Object.hasOwn(VERBS, verb ?? '')) throw new UsageError(USAGE);
  return VERBS[verb](args);
}

try {
  process.exitCode = await run(process.argv.slice(2));
} catch (error) {
  process.stderr.write(`${error instanceof UsageError ? error.message : error instanceof HapfError ? error.message : error.stack}\n`);
  process.exitCode = 1;
}
