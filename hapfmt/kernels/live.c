/* Many blocks of samples, all equally long, to packets of LPCR in one call. The readable twin is
   hapfmt/encoder/live_many.py.

   Widths: counts and zeros lie within 33 bits, steps within 31, so that no difference, nor twice one
   and a step, leaves 36; an error times kd or a count times kn stays below 2^52. */
#include "kernels.h"

#if defined(__GNUC__)
/* Of the headers, not all is needed here. */
#pragma GCC diagnostic ignored "-Wunused-function"
#endif

#include "live.h"
#include "live_knots.h"

/* Where a block is worked on: [samples] each, rows four times as many; and two packets of so many
   bytes. */
typedef struct {
    int64_t *counts, *indices, *rows;
    uint8_t *packet, *other;
    int64_t room;
    workshop w;
} desk;

static int sound(const task *t, int64_t grids)
{
    const int64_t bound = (int64_t)1 << 32;
    int fits = t->low >= -bound && t->low <= t->high && t->high <= bound && t->zero >= -bound &&
               t->zero <= bound && t->grid >= -1 && t->grid < grids &&
               (t->grid >= 0 || (t->step >= 1 && t->step < bound)) && t->kn >= 0 &&
               t->kn < 65536 && t->kd >= 0 && t->kd < 65536 && t->floor >= 0 &&
               t->floor <= bound && t->felt >= -bound && t->felt <= bound &&
               t->way >= AS_INDICES && t->way <= JOINED && (t->way == AS_INDICES || t->kd) &&
               t->slack >= 0 && t->slack <= bound;
    return fits;
}

static int usual(const habit *h)
{
    int fits = h->order >= 0 && h->order <= ORDERS && h->difference >= 0 &&
               h->difference <= DIFFERENCES && !(h->way & ~(REPEATS | QUICK)) &&
               (!(h->way & QUICK) || h->way == QUICK);
    for (int i = 0; fits && i < h->order; i++) fits = h->reflections[i] > -128;
    return fits;
}

#define COPY(type)                                              \
    for (int64_t i = 0; i < count; i++) {                       \
        int64_t x = ((const type *)from)[i];                    \
        out[i] = x;                                             \
        beyond |= (uint64_t)(x - low) | (uint64_t)(high - x);   \
    }

/* Samples as counts, and whether all lie in the declared range. */
static int take(const void *from, Py_ssize_t size, int64_t count, int64_t low, int64_t high,
                int64_t *out)
{
    uint64_t beyond = 0;
    if (size == 2) COPY(int16_t)
    else if (size == 4) COPY(int32_t)
    else {
        const int64_t *x = from;
        for (int64_t i = 0; i < count; i++) {
            beyond |= (uint64_t)(x[i] < low) | (uint64_t)(x[i] > high);
            out[i] = x[i];
        }
        return !beyond;
    }
    return !(beyond >> 63);
}

/* Nearest multiples of the step, halves up. */
static void on_steps(const task *t, const int64_t *x, int64_t count, int64_t *out)
{
    int64_t step = t->step, zero = t->zero;
    double inverse = 1.0 / (double)(2 * step);
    if (step == 1) {
        for (int64_t i = 0; i < count; i++) out[i] = x[i] - zero;
        return;
    }
    for (int64_t i = 0; i < count; i++) {
        int64_t n = 2 * (x[i] - zero) + step, q = (int64_t)((double)n * inverse);
        int64_t rest = n - q * 2 * step;
        out[i] = q + (rest >= 2 * step) - (rest < 0);
    }
}

/* The cell of each count; 0 where one lies beyond the last. */
static int on_levels(const task *t, const cells *g, const int64_t *x, int64_t count, int64_t *out)
{
    int64_t at = 0;
    for (int64_t i = 0; i < count; i++) {
        int64_t c = x[i] - t->zero, size = c < 0 ? -c : c;
        at = first_from(g->tops, g->count, size, at);
        if (at == g->count) return 0;
        out[i] = c < 0 ? -at : at;
    }
    return 1;
}

/* Whether every index stands for a count within the contract. */
static int keeps(const task *t, const cells *g, const int64_t *x, const int64_t *indices,
                 int64_t count)
{
    int64_t bad = 0;
    for (int64_t i = 0; i < count; i++) {
        int64_t k = indices[i], y;
        if (g)
            y = t->zero + (k < 0 ? -g->levels[-k] : g->levels[k]);
        else
            y = t->zero + k * t->step;
        y = y < t->low ? t->low : y > t->high ? t->high : y;
        int64_t e = x[i] < y ? y - x[i] : x[i] - y, r = x[i] < t->felt ? t->felt - x[i] : x[i] - t->felt;
        bad |= (e > t->floor) & (e * t->kd > r * t->kn);
    }
    return !bad;
}

static int64_t put_base(uint8_t *out, int64_t base)
{
    uint64_t v = zigzag(base);
    int64_t size = 0;
    for (; v > 0x7F; v >>= 7) out[size++] = (uint8_t)(v | 0x80);
    out[size++] = (uint8_t)v;
    return size;
}

/* Bytes of the packet of these indices, which are not all the same, or what went wrong. */
static int64_t pack(const habit *h, const row *r, desk *d, uint8_t *packet)
{
    plan p = plan_of(h, r);
    uint8_t *out = packet;
    int64_t size = 0;
    int status;
    if (!valid(&p)) return NO_CODE;
    *out++ = (uint8_t)(p.difference | (h->way & REPEATS));
    *out++ = (uint8_t)p.order;
    memcpy(out, h->reflections, (size_t)p.order);
    out += p.order;
    out += put_base(out, p.base);
    int64_t room = d->room - (out - packet);
    status = encode(&d->w, &p, r->indices, out, room, &size);
    return status == DONE ? out - packet + size : status == NO_ROOM ? FULL : NO_CODE;
}

/* With a predictor that little work finds. */
static int64_t pack_quick(const row *r, const choice *ways, desk *d)
{
    habit h = {0, 0, mostly_repeats(r, QUICK_REPEATS) ? REPEATS : 0, 0, {0}, {0}};
    row from_first = *r;
    from_first.mean = r->first;
    h.difference = choose(r->indices, r->count, ways->sines, ways->limits, ways->costs,
                          h.reflections, h.coefficients, &h.order);
    int64_t size = pack(&h, &from_first, d, d->packet);
    if (size != NO_CODE) return size;
    /* An error too large in what was not looked at. */
    h.order = h.difference = h.way = 0;
    return pack(&h, &from_first, d, d->packet);
}

/* The smallest of some packets, and its predictor. */
static int64_t look(habit *h, int before, const row *r, const choice *ways, desk *d)
{
    habit tried[3];
    int count = 0, best = -1;
    int64_t least = 0;
    tried[count++] = best_guess(r, ways);
    if (mostly_repeats(r, REPEAT_SHARE)) {
        tried[count] = tried[0];
        tried[count++].way |= REPEATS;
    }
    if (before) tried[count++] = *h;
    for (int i = 0; i < count; i++) {
        int64_t size = pack(tried + i, r, d, d->other);
        if (size == FULL) return FULL;
        if (size == NO_CODE || (best >= 0 && size >= least)) continue;
        uint8_t *kept = d->packet;
        d->packet = d->other;
        d->other = kept;
        least = size;
        best = i;
    }
    *h = tried[best];
    return least;
}

enum { GIVEN = 0, LOOK = 1, LOOK_BESIDE = 2 };

static int64_t work(const task *t, habit *h, int how, const cells *grids, const choice *ways,
                    desk *d, const Py_buffer *block, int64_t count)
{
    const cells *g = t->grid < 0 ? NULL : grids + t->grid;
    int64_t same = 1, *x = d->indices;
    if (!take(block->buf, block->itemsize, count, t->low, t->high, d->counts)) return OUTSIDE;
    if (t->way != AS_INDICES)
        return hapfmt_live_knots(t, g, d->counts, count, d->rows, d->packet, d->room);
    if (!g)
        on_steps(t, d->counts, count, x);
    else if (!on_levels(t, g, d->counts, count, x))
        return OUTSIDE;
    if (t->kd && !keeps(t, g, d->counts, x, count)) return BROKEN;
    while (same < count && x[same] == x[0]) same++;
    if (same == count) {
        d->packet[0] = 16;
        d->packet[1] = 0;
        return 2 + put_base(d->packet + 2, x[0]);
    }
    if (!within(x, count, INDEX_LIMIT)) return NO_CODE;
    row r = row_of(x, count);
    if (h->way & QUICK) return pack_quick(&r, ways, d);
    if (how == GIVEN) return pack(h, &r, d, d->packet);
    return look(h, how == LOOK_BESIDE, &r, ways, d);
}

static int is_block(const Py_buffer *b, int64_t count)
{
    return (b->itemsize == 2 || b->itemsize == 4 || b->itemsize == 8) && b->ndim == 1 &&
           b->format && b->format[0] && !b->format[1] && strchr("hilq", b->format[0]) &&
           b->len == b->itemsize * count && whole(b, b->itemsize);
}

static int is_grid(const Py_buffer *b, cells *g)
{
    g->count = b->len / 16;
    g->levels = b->buf;
    g->tops = g->levels + g->count;
    int fits = g->count > 0 && b->len % 16 == 0 && whole(b, 8) && g->levels[0] == 0;
    for (int64_t i = 0; fits && i < g->count; i++)
        fits = g->levels[i] >= 0 && g->levels[i] <= (int64_t)1 << 33 &&
               (!i || (g->levels[i - 1] < g->levels[i] && g->tops[i - 1] <= g->tops[i]));
    return fits;
}

/* All counts of the grids about 0; 0 where memory ran out. */
static int spread(cells *given, Py_ssize_t kinds)
{
    for (Py_ssize_t i = 0; i < kinds; i++) {
        cells *g = given + i;
        g->all = PyMem_Malloc((size_t)(8 * (2 * g->count - 1)));
        if (!g->all) return 0;
        for (int64_t k = 0; k < g->count; k++) {
            g->all[g->count - 1 - k] = -g->levels[k];
            g->all[g->count - 1 + k] = g->levels[k];
        }
    }
    return 1;
}

/* Buffers of a list's items; how many were got. */
static Py_ssize_t get_all(PyObject *list, Py_buffer *out, Py_ssize_t count, int flags)
{
    Py_ssize_t i = 0;
    for (; i < count; i++) {
        PyObject *item = PyList_GetItem(list, i);
        if (!item || PyObject_GetBuffer(item, out + i, flags)) break;
    }
    return i;
}

static int are_sound(const Py_buffer *tasks, const Py_buffer *habits, const Py_buffer *hows,
                     Py_ssize_t n, Py_ssize_t grids)
{
    int fits = n > 0 && whole(tasks, 8) && tasks->len == n * (Py_ssize_t)sizeof(task) &&
               whole(habits, 4) && habits->len == n * (Py_ssize_t)sizeof(habit) && hows->len == n;
    for (Py_ssize_t i = 0; fits && i < n; i++)
        fits = sound((const task *)tasks->buf + i, grids) && usual((const habit *)habits->buf + i) &&
               ((const uint8_t *)hows->buf)[i] <= LOOK_BESIDE;
    return fits;
}

static int are_tables(const Py_buffer *sines, const Py_buffer *limits, const Py_buffer *costs)
{
    int fits = whole(sines, 4) && sines->len == 4 * 128 && whole(limits, 8) &&
               limits->len == 8 * 127 && whole(costs, 8) && costs->len == 8 * QUICK_ORDERS;
    for (int i = 0; fits && i < 128; i++)
        fits = ((int32_t *)sines->buf)[i] >= 0 && ((int32_t *)sines->buf)[i] < 32768;
    return fits;
}

static int take_desk(desk *d, int64_t count)
{
    d->room = 8 * count + 2 * HEADER;
    d->counts = PyMem_Malloc((size_t)(8 * count));
    d->indices = PyMem_Malloc((size_t)(8 * count));
    d->rows = PyMem_Malloc((size_t)(32 * count));
    d->packet = PyMem_Malloc((size_t)d->room);
    d->other = PyMem_Malloc((size_t)d->room);
    return workshop_open(&d->w, count) && d->counts && d->indices && d->rows && d->packet && d->other;
}

static void leave_desk(desk *d)
{
    PyMem_Free(d->counts);
    PyMem_Free(d->indices);
    PyMem_Free(d->rows);
    PyMem_Free(d->packet);
    PyMem_Free(d->other);
    workshop_close(&d->w);
}

/* (blocks: list of int16, int32 or int64 [samples], grids: list of int64 [2, levels], tasks, habits,
   hows: uint8 [blocks], sines int32 [128], limits float64 [127], costs float64 [12], packets, ends
   int64 [blocks]) -> bytes written. An end is where a packet ends, or for a block that has none, what
   went wrong; habits become those that were found. */
static PyObject *encode_blocks(PyObject *self, PyObject *args)
{
    (void)self;
    PyObject *blocks, *grids, *result = NULL;
    Py_buffer tasks, habits, hows, sines, limits, costs, out, ends, *views = NULL, *shapes = NULL;
    Py_ssize_t got = 0, grids_got = 0;
    cells *given = NULL;
    desk d = {NULL, NULL, NULL, NULL, NULL, 0, {NULL, NULL, NULL}};
    if (!PyArg_ParseTuple(args, "OOy*w*y*y*y*y*w*w*", &blocks, &grids, &tasks, &habits, &hows, &sines,
                          &limits, &costs, &out, &ends))
        return NULL;
    int fits = PyList_Check(blocks) && PyList_Check(grids);
    Py_ssize_t n = fits ? PyList_Size(blocks) : 0, kinds = fits ? PyList_Size(grids) : 0;
    fits = fits && are_sound(&tasks, &habits, &hows, n, kinds) && whole(&ends, 8) &&
           ends.len == 8 * n && are_tables(&sines, &limits, &costs);
    if (!fits) goto done;
    views = PyMem_Malloc((size_t)n * sizeof *views);
    shapes = PyMem_Malloc((size_t)(kinds + 1) * sizeof *shapes);
    given = PyMem_Calloc((size_t)(kinds + 1), sizeof *given);
    if (!views || !shapes || !given) {
        PyErr_NoMemory();
        goto done;
    }
    got = get_all(blocks, views, n, PyBUF_FORMAT | PyBUF_ND);
    if (got < n) goto done;
    grids_got = get_all(grids, shapes, kinds, PyBUF_SIMPLE);
    if (grids_got < kinds) goto done;
    int64_t count = views[0].itemsize ? views[0].len / views[0].itemsize : 0;
    fits = count > 0 && count <= 1 << 24;
    for (Py_ssize_t i = 0; fits && i < n; i++) fits = is_block(views + i, count);
    for (Py_ssize_t i = 0; fits && i < kinds; i++) fits = is_grid(shapes + i, given + i);
    if (!fits) goto done;
    if (!spread(given, kinds) || !take_desk(&d, count)) {
        PyErr_NoMemory();
        goto done;
    }
    int64_t at = 0;
    Py_BEGIN_ALLOW_THREADS
    choice ways = {sines.buf, limits.buf, costs.buf};
    for (Py_ssize_t i = 0; i < n; i++) {
        int64_t size = work((const task *)tasks.buf + i, (habit *)habits.buf + i,
                            ((const uint8_t *)hows.buf)[i], given, &ways, &d, views + i, count);
        if (size > out.len - at) size = FULL;
        if (size > 0) {
            memcpy((uint8_t *)out.buf + at, d.packet, (size_t)size);
            at += size;
        }
        ((int64_t *)ends.buf)[i] = size > 0 ? at : size;
    }
    Py_END_ALLOW_THREADS
    result = PyLong_FromLongLong(at);
done:
    if (!result && !PyErr_Occurred())
        PyErr_SetString(PyExc_ValueError, "not blocks of equal length, or not what they are coded by");
    leave_desk(&d);
    for (Py_ssize_t i = 0; given && i < kinds; i++) PyMem_Free(given[i].all);
    for (Py_ssize_t i = 0; i < got; i++) PyBuffer_Release(views + i);
    for (Py_ssize_t i = 0; i < grids_got; i++) PyBuffer_Release(shapes + i);
    PyMem_Free(views);
    PyMem_Free(shapes);
    PyMem_Free(given);
    PyBuffer_Release(&tasks);
    PyBuffer_Release(&habits);
    PyBuffer_Release(&hows);
    PyBuffer_Release(&sines);
    PyBuffer_Release(&limits);
    PyBuffer_Release(&costs);
    PyBuffer_Release(&out);
    PyBuffer_Release(&ends);
    return result;
}

PyMethodDef hapfmt_live_methods[] = {
    {"encode_blocks", encode_blocks, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
