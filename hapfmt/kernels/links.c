/* The fewest lines in an integer tube; the readable twin, step for step, is hapfmt/encoder/tube.py,
   which also works out why nothing here leaves 64 bits. Memory grows with what is found (knots,
   bounds of lines), by doubling; the loops over ticks allocate nothing. */
#include "links.h"
#include <stdlib.h>

enum { BEFORE = 2, SAMPLES = 4, SCAN = 64, NARROW = 4, VERIFIED = 17 };

void hapfmt_origins(const search *s, const knot *from, int32_t tick, int64_t place, int early,
                    int64_t *least, int64_t *most)
{
    const grid *g = &s->values;
    int64_t low = value_of(g, from->low), high = value_of(g, from->high);
    int64_t run = tick - from->tick, rest = run, along = 0, value = value_of(g, place);
    const int64_t *lower = s->in.lower, *upper = s->in.upper;
    for (int32_t t = from->tick + 1; t < tick; t++) {
        rest--;
        along += 2 * value;
        int64_t floor = run * (2 * lower[t] - 1) - along;
        int64_t ceiling = run * (2 * upper[t] + 1) - along - 1;
        /* Divided only where a bound moves. */
        if (floor > 2 * rest * low) low = -floor_div(-floor, 2 * rest);
        if (ceiling < 2 * rest * high) high = floor_div(ceiling, 2 * rest);
        if (early && low > high) break;
    }
    *least = place_from(g, low);
    *most = place_to(g, high);
}

/* The widest step between places of a knot, grids being finest at one place. */
static int64_t apart(const grid *g, const knot *k)
{
    int64_t below = value_of(g, k->low + 1) - value_of(g, k->low);
    int64_t above = value_of(g, k->high) - value_of(g, k->high - 1);
    return below > above ? below : above;
}

/* The part of the places [low, high] that lines from places reach without a gap; 0: nothing. */
static int verified(const search *s, const knot *from, int32_t tick, int64_t *low, int64_t *high)
{
    const grid *g = &s->values;
    int64_t least, most, ends[2], wide = apart(g, from);
    int found = 0;
    if (*high - *low >= NARROW) {
        int64_t middle = (*low + *high) >> 1;
        for (int side = 0; side < 2; side++) {
            int64_t end = side ? *high : *low, step = side ? -1 : 1;
            for (int64_t value = end, wider = step; (middle - value) * step >= 0; wider *= 2) {
                hapfmt_origins(s, from, tick, value, 1, &least, &most);
                if (least <= most && value_of(g, most) - value_of(g, least) >= wide) {
                    ends[found++] = value;
                    break;
                }
                value = end + wider;
            }
        }
    }
    if (found == 2) {
        *low = ends[0];
        *high = ends[1];
        return 1;
    }
    int64_t cut = (*high - *low + 1 - VERIFIED) / 2, best = 0, run = 0, last = 0;
    if (cut < 0) cut = 0;
    for (int64_t value = *low + cut; value <= *high - cut; value++) {
        hapfmt_origins(s, from, tick, value, 1, &least, &most);
        run = least <= most ? run + 1 : 0;
        if (run > best) {
            best = run;
            last = value;
        }
    }
    *low = last - best + 1;
    *high = last;
    return best > 0;
}

static const line *line_at(const line_log *log, int32_t tick)
{
    size_t i = log->size - 1;
    while (log->entries[i].from > tick) i--;
    return &log->entries[i].is;
}

int hapfmt_arrive(const search *s, const way *w, int32_t tick, part *out)
{
    const knot *from = &s->knots[w->knot];
    int64_t low = s->in.lower[tick], high = s->in.upper[tick];
    int near = tick == from->tick + 1;
    out->knot = w->knot;
    if (!near) {
        const line *l = line_at(&w->lines.highest, tick - 1);
        int64_t most = (l->y - 1 - floor_div(-l->dy * (tick - l->x), l->dx)) >> 1;
        l = line_at(&w->lines.lowest, tick - 1);
        int64_t least = -((floor_div(-l->dy * (tick - l->x), l->dx) - l->y) >> 1);
        if (most < high) high = most;
        if (least > low) low = least;
    }
    low = place_from(&s->values, low);
    high = place_to(&s->values, high);
    if (low > high) return 0;
    if (!near && from->low != from->high && !verified(s, from, tick, &low, &high)) return 0;
    out->low = low;
    out->high = high;
    return 1;
}

static int meet(const search *s, const generation *g, int32_t tick, meeting *out)
{
    int size = 0, begin = 0;
    int64_t high = 0;
    for (int i = 0; i < g->size; i++) {
        const way *w = &g->ways[i];
        part found;
        if (s->knots[w->knot].tick >= tick || tick >= w->lines.stop || !hapfmt_arrive(s, w, tick, &found))
            continue;
        int at = size++;
        for (; at > 0; at--) {
            const part *before = &out->parts[at - 1];
            if (before->low < found.low || (before->low == found.low && before->high <= found.high))
                break;
            out->parts[at] = *before;
        }
        out->parts[at] = found;
    }
    out->tick = tick;
    out->end = 0;
    for (int i = 0; i < size; i++) {
        if (!i || out->parts[i].low > high + 1) {
            begin = i;
            high = out->parts[i].high;
        }
        int64_t low = out->parts[begin].low;
        if (out->parts[i].high > high) high = out->parts[i].high;
        if (!out->end || high - low >= out->high - out->low) {
            out->low = low;
            out->high = high;
            out->begin = begin;
            out->end = i + 1;
        }
    }
    return out->end;
}

static int grow(void **rows, size_t *room, size_t needed, size_t size)
{
    if (needed <= *room) return 0;
    size_t more = *room ? 2 * *room : 256;
    void *grown = realloc(*rows, more * size);
    if (!grown) return -1;
    *rows = grown;
    *room = more;
    return 0;
}

int hapfmt_keep(search *s, const meeting *m)
{
    int count = m->end - m->begin;
    if (grow((void **)&s->knots, &s->knot_room, s->knot_count + 1, sizeof *s->knots) ||
        grow((void **)&s->parts, &s->part_room, s->part_count + WAYS, sizeof *s->parts))
        return -1;
    knot made = {m->low, m->high, s->part_count, m->tick, count};
    s->knots[s->knot_count++] = made;
    memcpy(s->parts + s->part_count, m->parts + m->begin, (size_t)count * sizeof *m->parts);
    s->part_count += (size_t)count;
    return 0;
}

int hapfmt_add_way(search *s, generation *g)
{
    way *w = &g->ways[g->size++];
    w->knot = s->knot_count - 1;
    const knot *from = &s->knots[w->knot];
    point low = {2 * value_of(&s->values, from->low), from->tick};
    point high = {2 * value_of(&s->values, from->high), from->tick};
    s->below.points[0] = low;
    s->above.points[0] = high;
    s->below.size = s->above.size = 1;
    return hapfmt_sweep_lines(&s->in, 1, from->tick + 1, &s->below, &s->above, &w->lines);
}

/* Where the furthest of the lines crosses that cross the extreme one from tick ``touch`` on, its
   last touch: the tick before that, and the tick where it stops. */
static int crossing(search *s, const sweep *from, int32_t touch, int32_t *at, int32_t *stop)
{
    int32_t last = from->stop - 1;
    int sign = from->side > 0 ? 1 : -1;
    const int64_t *floors = sign > 0 ? s->in.lower : s->in.upper;
    line extreme = *last_line(sign > 0 ? &from->lowest : &from->highest);
    extreme.y *= sign;
    extreme.dy *= sign;
    s->below.size = 0;
    for (int32_t t = touch; t <= last; t++)
        hapfmt_hull_append(&s->below, t, 2 * sign * floors[t] - 1);
    point over = {round_at(&extreme, last) + 1, last};
    s->above.points[0] = over;
    s->above.size = 1;
    if (hapfmt_sweep_lines(&s->in, sign, last + 1, &s->below, &s->above, &s->ahead)) return -1;
    const line *furthest = last_line(s->ahead.side > 0 ? &s->ahead.lowest : &s->ahead.highest);
    int32_t low = touch, high = last;
    while (low < high) {
        int32_t middle = (low + high + 1) / 2;
        if (round_at(furthest, middle) >= round_at(&extreme, middle)) low = middle;
        else high = middle - 1;
    }
    *at = low;
    *stop = s->ahead.stop;
    return 0;
}

int hapfmt_candidates(search *s, const way *w, int32_t *ticks, int32_t *enough)
{
    int32_t last = w->lines.stop - 1, begin = s->knots[w->knot].tick, at, stop;
    const line *l = last_line(w->lines.side > 0 ? &w->lines.lowest : &w->lines.highest);
    int32_t touch = (int32_t)clamp((int64_t)l->x + l->dx, begin + 1, last);
    if (crossing(s, &w->lines, touch, &at, &stop)) return -1;
    int32_t step = (last - touch) / SAMPLES > 1 ? (last - touch) / SAMPLES : 1;
    int32_t least = touch - BEFORE > begin + 1 ? touch - BEFORE : begin + 1;
    int32_t tried[6 + BEFORE] = {at, at + 1, at - 1, at + 2, at - 2, last, touch - 1, touch - 2};
    int count = 0;
    for (int32_t i = 0, spread = touch; i < 6 + BEFORE || spread < last; i++) {
        int32_t tick = spread;
        if (i < 6 + BEFORE) tick = tried[i];
        else spread += step;
        int known = tick < least || tick > last;
        for (int j = 0; j < count && !known; j++) known = ticks[j] == tick;
        if (!known && count < CANDIDATES) ticks[count++] = tick;
    }
    *enough = stop - (stop - last) / SLACK;
    return count;
}

/* A knot about as late as whole values allow, where none of the candidates is reached. */
static void retreat(const search *s, const generation *g, int32_t last, meeting *out)
{
    int32_t early = 0, late = last, tick = last;
    for (int i = 0; i < g->size; i++)
        if (s->knots[g->ways[i].knot].tick >= early) early = s->knots[g->ways[i].knot].tick + 1;
    do {
        int32_t step = last - late < SCAN ? 1 : last - late;
        tick = late;
        late = late - step > early ? late - step : early;
    } while (!meet(s, g, late, out) && late > early);
    while (tick - late > 1) {
        int32_t middle = (late + tick) / 2;
        meeting found;
        if (meet(s, g, middle, &found)) {
            late = middle;
            *out = found;
        } else
            tick = middle;
    }
}

/* The ways after ``g``; done: the last knot found is at the tube's end. */
static int next_ways(search *s, const generation *g, generation *next, int *done)
{
    const way *furthest = &g->ways[0];
    meeting found;
    for (int i = 1; i < g->size; i++)
        if (g->ways[i].lines.stop > furthest->lines.stop) furthest = &g->ways[i];
    int32_t last = furthest->lines.stop - 1, ticks[CANDIDATES], enough = 0, longest = 0;
    if (!furthest->lines.side && meet(s, g, last, &found)) {
        *done = 1;
        return hapfmt_keep(s, &found);
    }
    int tries = TRIES + (last - s->knots[furthest->knot].tick < SHORT);
    int count = hapfmt_candidates(s, furthest, ticks, &enough);
    if (count < 0) return -1;
    next->size = 0;
    for (int i = 0; i < count; i++) {
        if (!meet(s, g, ticks[i], &found)) continue;
        if (hapfmt_keep(s, &found) || hapfmt_add_way(s, next)) return -1;
        int32_t stop = next->ways[next->size - 1].lines.stop;
        if (stop > longest) longest = stop;
        if (next->size >= tries && longest >= enough) break;
    }
    if (next->size) return 0;
    retreat(s, g, last, &found);
    return hapfmt_keep(s, &found) || hapfmt_add_way(s, next) ? -1 : 0;
}

/* Backwards from the last knot: at each one a place from which the next is reached. */
static int64_t choose(const search *s, int64_t *ticks, int64_t *values)
{
    const knot *k = &s->knots[s->knot_count - 1];
    int64_t place = (k->low + k->high) / 2, count = 0, low, high;
    ticks[count] = k->tick;
    values[count++] = value_of(&s->values, place);
    while (k->part_count) {
        const part *p = s->parts + k->parts;
        while (place < p->low || place > p->high) p++;
        const knot *before = &s->knots[p->knot];
        hapfmt_origins(s, before, k->tick, place, 0, &low, &high);
        /* The place nearest to that of the next knot: small differences are coded in few bits. */
        k = before;
        place = clamp(place, low, high);
        ticks[count] = k->tick;
        values[count++] = value_of(&s->values, place);
    }
    for (int64_t i = 0, j = count - 1; i < j; i++, j--) {
        int64_t tick = ticks[i], other = values[i];
        ticks[i] = ticks[j];
        values[i] = values[j];
        ticks[j] = tick;
        values[j] = other;
    }
    return count;
}

int hapfmt_reaches(const grid *g, const tube *in)
{
    int64_t last = 0, least = value_of(g, 0), most = value_of(g, g->count - 1);
    for (int32_t t = 0; t < in->size; t++) {
        int64_t low = in->lower[t], high = in->upper[t], value = value_of(g, last);
        if (low <= value && value <= high) continue;
        if (!g->levels && low >= least && high <= most && high - low >= g->step - 1) continue;
        last = place_to(g, high);
        if (last < 0 || value_of(g, last) < low) return 0;
    }
    return 1;
}

int hapfmt_open(search *s, const tube *in, const grid *g)
{
    s->in = *in;
    s->values = *g;
    s->below.points = malloc(((size_t)in->size + 2) * sizeof *s->below.points);
    s->above.points = malloc(((size_t)in->size + 2) * sizeof *s->above.points);
    meeting start = {.low = place_from(g, in->lower[0]), .high = place_to(g, in->upper[0])};
    return !s->below.points || !s->above.points || hapfmt_keep(s, &start) ||
           hapfmt_add_way(s, &s->generations[0]);
}

void hapfmt_close(search *s)
{
    for (int i = 0; i < 2 * WAYS; i++) {
        sweep *each = &s->generations[i / WAYS].ways[i % WAYS].lines;
        free(each->highest.entries);
        free(each->lowest.entries);
    }
    free(s->ahead.highest.entries);
    free(s->ahead.lowest.entries);
    free(s->below.points);
    free(s->above.points);
    free(s->knots);
    free(s->parts);
}

int64_t hapfmt_fewest_linear(const tube *in, const grid *g, int64_t *ticks, int64_t *values)
{
    if (!hapfmt_reaches(g, in)) return 0;
    int64_t low = in->lower[0], high = in->upper[0], count = -1;
    for (int32_t t = 1; t < in->size; t++) {
        if (in->lower[t] > low) low = in->lower[t];
        if (in->upper[t] < high) high = in->upper[t];
    }
    low = place_from(g, low);
    high = place_to(g, high);
    if (low <= high) {
        ticks[0] = 0;
        values[0] = value_of(g, (low + high) / 2);
        return 1;
    }
    search *s = calloc(1, sizeof *s);
    int now = 0, done = 0, failed = !s || hapfmt_open(s, in, g);
    for (; !failed && !done; now = !now)
        failed = next_ways(s, &s->generations[now], &s->generations[!now], &done);
    if (!failed) count = choose(s, ticks, values);
    if (s) hapfmt_close(s);
    free(s);
    return count;
}
