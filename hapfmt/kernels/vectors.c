/* Few lines for all axes of a vector, their knots on one clock; the readable twin, step for step, is
   hapfmt/encoder/tube.py. Each axis has a search of its own; the way that goes on is the first of
   its generation. */
#include "links.h"
#include <stdlib.h>

static const way *front(const search *s, int now) { return &s->generations[now].ways[0]; }

/* The knots of all axes at ``tick``; 0 where one of them has none. */
static int meet(const search *axes, int count, int now, int32_t tick, meeting *found)
{
    for (int a = 0; a < count; a++) {
        const search *s = &axes[a];
        const way *w = front(s, now);
        part *only = &found[a].parts[0];
        if (s->knots[w->knot].tick >= tick || tick >= w->lines.stop ||
            !hapfmt_arrive(s, w, tick, only))
            return 0;
        found[a].low = only->low;
        found[a].high = only->high;
        found[a].tick = tick;
        found[a].begin = 0;
        found[a].end = 1;
    }
    return 1;
}

static int keep(search *axes, int count, const meeting *found)
{
    int failed = 0;
    for (int a = 0; a < count && !failed; a++) failed = hapfmt_keep(&axes[a], &found[a]);
    return failed;
}

/* The first tick that the lines of one axis cannot pass: for the way ``i`` of every axis. */
static int32_t stop_of(const search *axes, int count, int now, int i, int *slow)
{
    int32_t stop = INT32_MAX;
    for (int a = 0; a < count; a++)
        if (axes[a].generations[now].ways[i].lines.stop < stop) {
            stop = axes[a].generations[now].ways[i].lines.stop;
            *slow = a;
        }
    return stop;
}

enum { STEPS = CANDIDATES + 2 * SLACK };

/* Ticks for the next knots, best first; the last of them can always be reached. */
static int candidates(search *s, int now, int32_t last, int32_t begin, int32_t *ticks)
{
    int32_t enough, step = (last - begin) / SLACK > 1 ? (last - begin) / SLACK : 1;
    int count = 0;
    if (front(s, now)->lines.side) count = hapfmt_candidates(s, front(s, now), ticks, &enough);
    if (count < 0) return -1;
    for (int32_t t = last; t > begin && count < STEPS; t -= step) ticks[count++] = t;
    ticks[count++] = begin + 1;
    return count;
}

static int tried(const int32_t *ticks, int i)
{
    for (int j = 0; j < i; j++)
        if (ticks[j] == ticks[i]) return 1;
    return 0;
}

/* The ways after those of ``now``; done: the knots found last are at the tubes' end. */
static int next_ways(search *axes, int count, int now, meeting *found, int *done)
{
    int slow = 0, size = 0, best = 0;
    int32_t stop = stop_of(axes, count, now, 0, &slow), best_stop = 0, best_tick = 0;
    int32_t begin = axes[0].knots[front(axes, now)->knot].tick, ticks[STEPS + 1];
    if (stop >= axes[0].in.size && meet(axes, count, now, axes[0].in.size - 1, found)) {
        *done = 1;
        return keep(axes, count, found);
    }
    int number = candidates(&axes[slow], now, stop - 1, begin, ticks);
    if (number < 0) return -1;
    for (int a = 0; a < count; a++) axes[a].generations[!now].size = 0;
    for (int i = 0; i < number; i++) {
        if (tried(ticks, i) || !meet(axes, count, now, ticks[i], found)) continue;
        if (keep(axes, count, found)) return -1;
        for (int a = 0; a < count; a++)
            if (hapfmt_add_way(&axes[a], &axes[a].generations[!now])) return -1;
        int32_t reached = stop_of(axes, count, !now, size, &slow);
        if (reached > best_stop || (reached == best_stop && ticks[i] > best_tick)) {
            best_stop = reached;
            best_tick = ticks[i];
            best = size;
        }
        if (++size > TRIES + (ticks[i] - begin < SHORT)) break;
    }
    if (!size) return -1;
    for (int a = 0; a < count; a++) {
        way *ways = axes[a].generations[!now].ways, other = ways[0];
        ways[0] = ways[best];
        ways[best] = other;
    }
    return 0;
}

/* Backwards from the last knots, into the end of both rows. */
static int64_t choose(const search *axes, int count, int64_t *ticks, int64_t *places)
{
    int64_t size = axes[0].in.size, number = 0;
    for (int a = 0; a < count; a++) {
        const search *s = &axes[a];
        const knot *k = &s->knots[s->knot_count - 1];
        int64_t place = (k->low + k->high) / 2, low, high;
        for (number = 1;; number++) {
            ticks[size - number] = k->tick;
            places[(size - number) * count + a] = place;
            if (!k->part_count) break;
            const knot *before = &s->knots[s->parts[k->parts].knot];
            hapfmt_origins(s, before, k->tick, place, 0, &low, &high);
            place = clamp(place, low, high);
            k = before;
        }
    }
    return number;
}

int64_t hapfmt_fewest_joined(const tube *tubes, const grid *grids, int count, int64_t *ticks,
                             int64_t *places)
{
    int64_t number = -1;
    int now = 0, done = 0, failed;
    if (count < 1) return 0;
    for (int a = 0; a < count; a++)
        if (!hapfmt_reaches(&grids[a], &tubes[a])) return 0;
    search *axes = calloc((size_t)count, sizeof *axes);
    meeting *found = malloc((size_t)count * sizeof *found);
    failed = !axes || !found;
    for (int a = 0; a < count && !failed; a++) failed = hapfmt_open(&axes[a], &tubes[a], &grids[a]);
    for (; !failed && !done; now = !now) failed = next_ways(axes, count, now, found, &done);
    if (!failed) number = choose(axes, count, ticks, places);
    for (int a = 0; a < count && axes; a++) hapfmt_close(&axes[a]);
    free(axes);
    free(found);
    return number;
}
