/* All lines through a stretch of an integer tube at once; the readable twin is
   hapfmt/encoder/tube.py, and the widths are worked out in tube.py. */
#include "tube.h"
#include <stdlib.h>

static int note(line_log *log, int32_t from, line is)
{
    if (log->size == log->room) {
        size_t room = log->room ? 2 * log->room : 64;
        entry *entries = realloc(log->entries, room * sizeof *entries);
        if (!entries) return -1;
        log->entries = entries;
        log->room = room;
    }
    log->entries[log->size].from = from;
    log->entries[log->size++].is = is;
    return 0;
}

void hapfmt_hull_append(hull *h, int32_t tick, int64_t y)
{
    while (h->size > 1) {
        const point *p = &h->points[h->size - 2], *q = p + 1;
        if ((q->y - p->y) * (tick - q->x) > (y - q->y) * (q->x - p->x)) break;
        h->size--;
    }
    h->points[h->size].x = tick;
    h->points[h->size++].y = y;
}

static int64_t tangent(const hull *h, int64_t pivot, int32_t tick, int64_t y, int sign)
{
    for (; pivot + 1 < h->size; pivot++) {
        const point *p = &h->points[pivot], *q = p + 1;
        if (sign * ((y - q->y) * (tick - p->x) - (y - p->y) * (tick - q->x)) > 0) break;
    }
    return pivot;
}

/* Takes (tick, y) onto the lower (sign 1) or the upper bounds, behind ``pivot``. */
static inline void extend(hull *h, int64_t pivot, int32_t tick, int64_t y, int sign)
{
    while (h->size > pivot + 1) {
        const point *p = &h->points[h->size - 2], *q = p + 1;
        if (sign * ((q->y - p->y) * (tick - q->x) - (y - q->y) * (q->x - p->x)) > 0) break;
        h->size--;
    }
    h->points[h->size].x = tick;
    h->points[h->size++].y = y;
}

int hapfmt_sweep_lines(const tube *in, int sign, int32_t first, hull *below, hull *above,
                       sweep *out)
{
    const int64_t *floors = sign > 0 ? in->lower : in->upper;
    const int64_t *ceilings = sign > 0 ? in->upper : in->lower;
    int64_t i = 0, j = 0;
    line h = {below->points[0].y, 1, below->points[0].x, 0};
    line l = {above->points[0].y, -1, above->points[0].x, 0};
    if (h.x < l.x) {
        i = tangent(below, 0, l.x, l.y, 1);
        h.x = below->points[i].x;
        h.y = below->points[i].y;
        h.dx = l.x - h.x;
        h.dy = l.y - h.y;
    }
    out->highest.size = out->lowest.size = 0;
    if (note(&out->highest, first - 1, h) || note(&out->lowest, first - 1, l)) return -1;
    for (int32_t t = first; t < in->size; t++) {
        int64_t low = 2 * sign * floors[t] - 1, high = 2 * sign * ceilings[t] + 1;
        int64_t rise = h.dy * (t - h.x), fall = l.dy * (t - l.x);
        out->stop = t;
        out->side = -1;
        if ((low - h.y) * h.dx >= rise) return 0;
        out->side = 1;
        if ((high - l.y) * l.dx <= fall) return 0;
        if ((high - h.y) * h.dx < rise) {
            i = tangent(below, i, t, high, 1);
            h.x = below->points[i].x;
            h.y = below->points[i].y;
            h.dx = t - h.x;
            h.dy = high - h.y;
            if (note(&out->highest, t, h)) return -1;
        }
        if ((low - l.y) * l.dx > fall) {
            j = tangent(above, j, t, low, -1);
            l.x = above->points[j].x;
            l.y = above->points[j].y;
            l.dx = t - l.x;
            l.dy = low - l.y;
            if (note(&out->lowest, t, l)) return -1;
        }
        extend(below, i, t, low, 1);
        extend(above, j, t, high, -1);
    }
    out->stop = in->size;
    out->side = 0;
    return 0;
}
