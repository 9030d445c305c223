// Spans: lists of [start, stop], sorted, apart from one another.

// Adds a span to a list that ends at or before its start; touching spans become one.
export function pushSpan(spans, start, stop) {
  const last = spans[spans.length - 1];
  if (last !== undefined && last[1] === start) last[1] = stop;
  else if (stop > start) spans.push([start, stop]);
}

export function intersect(a, b) {
  const spans = [];
  for (let i = 0, j = 0; i < a.length && j < b.length;) {
    const start = Math.max(a[i][0], b[j][0]);
    const stop = Math.min(a[i][1], b[j][1]);
    if (start < stop) pushSpan(spans, start, stop);
    if (a[i][1] < b[j][1]) i++;
    else j++;
  }
  return spans;
}
