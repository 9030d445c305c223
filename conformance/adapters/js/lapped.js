// The lapped transform of MDCT (9.8). Every sum of products stays below 2^53 (Annex A): Numbers are exact.

export const LARGEST = 512;

// 32768 * cos(pi * i / 2048), rounded: a quarter of a wave. No entry but the last, 0, lies within 0.0005 of a tie:
// any Math.cos gives these.
export const COSINES = Float64Array.from({ length: 2 * LARGEST + 1 }, (_, i) => (
  Math.round(32768 * Math.cos((Math.PI * i) / (4 * LARGEST)))
));

// 32768 * cos(pi * i / (4 * M))
export function cosine(i, M) {
  const whole = 8 * LARGEST;
  let n = (i * (LARGEST / M)) % whole;
  if (n > whole / 2) n = whole - n;
  return n <= whole / 4 ? COSINES[n] : -COSINES[whole / 2 - n];
}

const transforms = new Map();

export function transformOf(M) {
  if (!transforms.has(M)) transforms.set(M, new Transform(M));
  return transforms.get(M);
}

class Transform {
  constructor(M) {
    this.size = M;
    // For each k the cosines of all j.
    this.waves = Array.from({ length: M }, (_, k) => (
      Float64Array.from({ length: M }, (_, j) => cosine((2 * j + 1) * (2 * k + 1), M))
    ));
    // For each i the weights of the samples i behind and i before a boundary.
    this.near = Float64Array.from({ length: M / 2 }, (_, i) => cosine(M - 1 - 2 * i, M));
    this.far = Float64Array.from({ length: M / 2 }, (_, i) => cosine(M + 1 + 2 * i, M));
  }

  // u of a block, of its first coefficients; those that follow are 0.
  unfold(X, u) {
    const { size, waves } = this;
    u.fill(0);
    for (let k = 0; k < X.length; k++) {
      const x = X[k];
      if (x === 0) continue;
      const wave = waves[k];
      for (let j = 0; j < size; j++) u[j] += x * wave[j];
    }
    for (let j = 0; j < size; j++) u[j] = Math.floor((u[j] + 1024) / 2048);
  }

  // The samples around a boundary: those of the second half of a block go to a[M/2] ..., those of the first half of
  // the next one to b[0] ...; u and v are theirs before.
  join(u, v, a, b) {
    const { size, near, far } = this;
    for (let i = 0; i < size / 2; i++) {
      const behind = v[i];
      const before = u[size - 1 - i];
      b[i] = Math.floor((near[i] * behind + far[i] * before + 4194304) / 8388608);
      a[size - 1 - i] = Math.floor((near[i] * before - far[i] * behind + 4194304) / 8388608);
    }
  }
}
