// The Fourier transform of real values whose number is a power of two.

export class Fft {
  // size: 4 or more
  constructor(size) {
    const half = size / 2;
    const bits = Math.log2(half);
    this.size = size;
    this.real = new Float64Array(half);
    this.imag = new Float64Array(half);
    this.cos = Float64Array.from({ length: half }, (_, k) => Math.cos((2 * Math.PI * k) / size));
    this.sin = Float64Array.from({ length: half }, (_, k) => Math.sin((2 * Math.PI * k) / size));
    this.places = new Uint32Array(half);
    for (let i = 0; i < half; i++) {
      let place = 0;
      for (let bit = 0; bit < bits; bit++) if (i & (1 << bit)) place |= 1 << (bits - 1 - bit);
      this.places[i] = place;
    }
  }

  // The squared magnitudes of the frequencies 0 to size / 2 into `power`.
  power(values, power) {
    const { size, real, imag, cos, sin, places } = this;
    const half = size / 2;
    // Even values are real parts, odd ones imaginary parts of a transform of half the size.
    for (let i = 0; i < half; i++) {
      real[places[i]] = values[2 * i];
      imag[places[i]] = values[2 * i + 1];
    }
    this.transform();
    power[0] = (real[0] + imag[0]) ** 2;
    power[half] = (real[0] - imag[0]) ** 2;
    for (let k = 1; k < half; k++) {
      const m = half - k;
      const evenReal = (real[k] + real[m]) / 2;
      const evenImag = (imag[k] - imag[m]) / 2;
      const oddReal = (imag[k] + imag[m]) / 2;
      const oddImag = (real[m] - real[k]) / 2;
      const a = evenReal + cos[k] * oddReal + sin[k] * oddImag;
      const b = evenImag + cos[k] * oddImag - sin[k] * oddReal;
      power[k] = a * a + b * b;
    }
  }

  transform() {
    const { real, imag, cos, sin } = this;
    const { length } = real;
    for (let width = 1; width < length; width *= 2) {
      const step = length / width; // in the tables, which have the angles of `size`
      for (let from = 0; from < length; from += 2 * width) {
        for (let j = 0; j < width; j++) {
          const [low, high] = [from + j, from + j + width];
          const [c, s] = [cos[j * step], sin[j * step]];
          const a = real[high] * c + imag[high] * s;
          const b = imag[high] * c - real[high] * s;
          real[high] = real[low] - a;
          imag[high] = imag[low] - b;
          real[low] += a;
          imag[low] += b;
        }
      }
    }
  }
}
