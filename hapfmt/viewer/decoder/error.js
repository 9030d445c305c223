// One class of errors: whatever bytes come, a function gives a value or a HapfError.

export class HapfError extends Error {
  constructor(kind, requirement, message, offset = null, also = []) {
    super(message);
    this.name = 'HapfError';
    this.kind = kind; // 'broken', 'unsupported' or 'truncated'
    this.requirement = requirement;
    this.offset = offset;
    this.also = also; // other rules that the same bytes break
  }
}

export function broken(requirement, message, offset) {
  throw new HapfError('broken', requirement, message, offset);
}

export function unsupported(requirement, message, offset) {
  throw new HapfError('unsupported', requirement, message, offset);
}

export function truncated(requirement, message, offset) {
  throw new HapfError('truncated', requirement, message, offset);
}
