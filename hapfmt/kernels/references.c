/* Channels that predict each other: which, and with which weights. The readable twin is
   hapfmt/encoder/references.py. Sums are of integers, exact in any order; what is computed from them is
   computed in the twin's order. */
#include "kernels.h"

#if defined(__GNUC__)
/* Not every function of the headers is used here. */
#pragma GCC diagnostic ignored "-Wunused-function"
#endif

#include "search.h"

enum { SOURCES = 8, REACH = 1, TAPS = 2 * REACH + 1, AWAY = 2 * REACH, SHIFTS = 2 * AWAY + 1 };
enum { SIZE = SOURCES * TAPS + 1, COMPONENTS = 256, SPAN_MOST = 1 << 24 };
enum { SETTLING = 33, LOUDEST = 4095, NORMAL = 7, LOUDNESS = 32, EXACT = 128, FIRST_ORDERS = 8 };
enum { ENOUGH = 4096, STRETCH = 256, WEIGHT_BITS = 6, COEFFICIENT_COST = 8 };
static const double NOISE = 1e-9;

typedef struct {
    const int32_t *sines;
    const double *limits;
} tables;

typedef struct {
    int8_t reflections[ORDERS];
    int32_t c[ORDERS];
    int order;
} linear;

typedef int64_t shifted[SHIFTS];

/* The order whose energy best repays its coefficients. */
static int best_order(const double *energies, int count, int64_t size)
{
    double a = 1.3862943611198906 * COEFFICIENT_COST / (double)size, factor = 1, least = 0;
    int found = 0;
    for (int m = 1; m <= count; m++) {
        factor *= 1 + a + a * a / 2;
        if (energies[m - 1] > 0 && (!found || energies[m - 1] * factor < least)) {
            least = energies[m - 1] * factor;
            found = m;
        }
    }
    return found;
}

/* A predictor of y with as many coefficients as repay themselves, or with all of ``orders``. */
static void predict_from(const int64_t *y, int64_t size, int orders, int all, const tables *t, linear *l)
{
    int64_t sums[LAGS];
    double r[LAGS], energies[ORDERS];
    autocorrelate(y, size, 0, 0, orders + 1, sums);
    for (int k = 0; k <= orders; k++) r[k] = (double)sums[k];
    r[0] = r[0] * (1 + NOISE) + (double)size / 12;
    int most = size - 1 < orders ? (int)(size - 1) : orders;
    int there = levinson(r, most, t->limits, l->reflections, energies);
    l->order = all ? there : best_order(energies, there, size);
    if (!step_up(l->reflections, l->order, t->sines, l->c)) l->order = 0;
}

/* Errors of the samples from ... from + count - 1, count at most PIECE. */
static void some_errors(const filter *f, const int64_t *y, int64_t from, int64_t count, int64_t *out)
{
    int64_t past[ORDERS + PIECE], room = from < ORDERS ? from : ORDERS;
    memset(past, 0, sizeof *past * (size_t)(ORDERS - room));
    memcpy(past + ORDERS - room, y + from - room, (size_t)(room + count) * sizeof *y);
    errors_of(f, past, count, out);
}

static void filter_of(filter *f, const linear *l, int64_t limit)
{
    plan p = {0};
    p.order = l->order;
    p.coefficients = l->c;
    p.limit = limit;
    filter_init(f, &p);
}

static int64_t largest_of(const int64_t *y, int64_t size)
{
    uint64_t most = 0;
    for (int64_t i = 0; i < size; i++) {
        uint64_t u = (uint64_t)(y[i] < 0 ? -y[i] : y[i]);
        if (u > most) most = u;
    }
    return (int64_t)most;
}

static void step_back(const int64_t *x, int64_t size, int64_t *y)
{
    y[0] = 0;
    for (int64_t i = 1; i < size; i++) y[i] = x[i] - x[i - 1];
}

/* By how many bits the errors of each block are shifted, so that their mean has NORMAL of them. */
static void shifts_of(const int64_t *e, int64_t size, int8_t *shifts)
{
    for (int64_t at = 0; at < size; at += LOUDNESS) {
        int64_t n = size - at < LOUDNESS ? size - at : LOUDNESS;
        uint64_t sum = 0;
        for (int64_t i = at; i < at + n; i++) sum += (uint64_t)(e[i] < 0 ? -e[i] : e[i]);
        uint64_t mean = sum / (uint64_t)n;
        shifts[at / LOUDNESS] = (int8_t)(NORMAL - bit_length(mean | !mean));
    }
}

INLINE int64_t within_loud(int64_t x) { return x < -LOUDEST ? -LOUDEST : x > LOUDEST ? LOUDEST : x; }

static void scale(const int64_t *e, int64_t size, const int8_t *shifts, int16_t *out)
{
    for (int64_t i = 0; i < size; i++) {
        int shift = shifts[i / LOUDNESS];
        int64_t x = shift < 0 ? e[i] >> -shift : within_loud(e[i]) * ((int64_t)1 << shift);
        out[i] = (int16_t)within_loud(x);
    }
}

/* Sums of a[t] * b[t + k], k from -AWAY to AWAY. */
INLINE void sum_shifted(const int16_t *a, const int16_t *b, int64_t size, int64_t *sums)
{
    memset(sums, 0, SHIFTS * sizeof *sums);
    for (int64_t from = AWAY; from < size - AWAY; from += EXACT) {
        int64_t n = size - AWAY - from < EXACT ? size - AWAY - from : EXACT;
        for (int k = -AWAY; k <= AWAY; k++) {
            const int16_t *x = a + from, *y = b + from + k;
            int32_t sum = 0;
            for (int64_t i = 0; i < n; i++) sum += x[i] * y[i];
            sums[AWAY + k] += sum;
        }
    }
}

#ifdef WIDE
WIDE static void sum_shifted_wide(const int16_t *a, const int16_t *b, int64_t size, int64_t *sums)
{
    sum_shifted(a, b, size, sums);
}
#endif

static void shifted_sums(const int16_t *a, const int16_t *b, int64_t size, int64_t *sums)
{
#ifdef WIDE
    if (wide()) {
        sum_shifted_wide(a, b, size, sums);
        return;
    }
#endif
    sum_shifted(a, b, size, sums);
}

/* The moments of all taps of the sources and, last, of the target: sums[i][j] of rows i >= j. */
static void moments_of(const shifted *sums, int rows, const int *sources, int count, int target,
                       int64_t size, double m[SIZE][SIZE])
{
    int last = TAPS * count;
    for (int i = 0; i <= last; i++)
        for (int j = 0; j <= last; j++) {
            int a = i < last ? sources[i / TAPS] : target, p = i < last ? i % TAPS - REACH : 0;
            int b = j < last ? sources[j / TAPS] : target, q = j < last ? j % TAPS - REACH : 0;
            m[i][j] = (double)(a >= b ? sums[a * rows + b][AWAY + q - p] : sums[b * rows + a][AWAY + p - q]);
            /* Roundings: without them, taps that are the same have no inverse. */
            if (i == j && i < last) m[i][j] += (double)size;
        }
}

/* Takes the moments of row k out of everything else (Gauss and Jordan). */
static void sweep_row(double m[SIZE][SIZE], int size, int k)
{
    double row[SIZE];
    for (int j = 0; j < size; j++) row[j] = m[k][j] / m[k][k];
    for (int i = 0; i < size; i++) {
        double factor = m[i][k];
        for (int j = 0; j < size; j++) m[i][j] -= factor * row[j];
    }
    memcpy(m[k], row, (size_t)size * sizeof *row);
}

static double energy_without(double m[SIZE][SIZE], int last, int place)
{
    double part[SIZE][SIZE];
    for (int i = 0; i <= TAPS; i++)
        for (int j = 0; j <= TAPS; j++)
            part[i][j] = m[i < TAPS ? TAPS * place + i : last][j < TAPS ? TAPS * place + j : last];
    for (int k = 0; k < TAPS; k++) sweep_row(part, TAPS + 1, k);
    return part[TAPS][TAPS] > 1 ? part[TAPS][TAPS] : 1;
}

/* Earlier rows one after the other, while each lowers the energy by ``factor``. out: how many, and
   which; energies: before and after. */
static void choose_sources(const shifted *sums, int rows, int target, int64_t size, double enough,
                           double factor, int64_t *out, double *energies)
{
    double m[SIZE][SIZE], scores[SOURCES], own = (double)sums[target * rows + target][AWAY] + 1;
    int likely[SOURCES] = {0}, count = 0, taken[SOURCES] = {0};
    for (int a = 0; a < target; a++) {
        double score = 0, other = (double)sums[a * rows + a][AWAY] + 1;
        for (int tap = -REACH; tap <= REACH; tap++) {
            double product = (double)sums[target * rows + a][AWAY + tap];
            score += product * product / (own * other);
        }
        int at = count;
        if (!(score > enough)) continue;
        while (at > 0 && scores[at - 1] < score) at--;
        if (at == SOURCES) continue;
        if (count < SOURCES) count++;
        memmove(scores + at + 1, scores + at, (size_t)(count - 1 - at) * sizeof *scores);
        memmove(likely + at + 1, likely + at, (size_t)(count - 1 - at) * sizeof *likely);
        scores[at] = score;
        likely[at] = a;
    }
    for (int i = 1; i < count; i++)
        for (int j = i; j > 0 && likely[j - 1] > likely[j]; j--) {
            int other = likely[j];
            likely[j] = likely[j - 1];
            likely[j - 1] = other;
        }
    int last = TAPS * count;
    moments_of(sums, rows, likely, count, target, size, m);
    energies[0] = energies[1] = m[last][last] > 1 ? m[last][last] : 1;
    for (int chosen = 0; chosen < count; chosen++) {
        int best = -1;
        double least = 0;
        for (int place = 0; place < count; place++) {
            if (taken[place]) continue;
            double energy = energy_without(m, last, place);
            if (best < 0 || energy < least) {
                best = place;
                least = energy;
            }
        }
        if (energies[1] < least * factor) break;
        energies[1] = least;
        taken[best] = 1;
        for (int k = 0; k < TAPS; k++) sweep_row(m, last + 1, TAPS * best + k);
    }
    out[0] = 0;
    for (int place = 0; place < count; place++)
        if (taken[place]) out[++out[0]] = likely[place];
}

/* What find_links needs for each row, and room to work in. */
typedef struct {
    int64_t *y, *e;
    int16_t *scaled;
    int8_t *shifts;
    shifted *sums;
} room;

static int room_open(room *r, int64_t rows, int64_t size, int64_t lines)
{
    r->y = malloc((size_t)(lines * size) * sizeof *r->y);
    r->e = malloc((size_t)(lines * size) * sizeof *r->e);
    r->scaled = malloc((size_t)(rows * size) * sizeof *r->scaled);
    r->shifts = malloc((size_t)(size / LOUDNESS + 1));
    r->sums = malloc((size_t)(rows * rows) * sizeof *r->sums);
    return r->y && r->e && r->scaled && r->shifts && r->sums;
}

static void room_close(room *r)
{
    free(r->y);
    free(r->e);
    free(r->scaled);
    free(r->shifts);
    free(r->sums);
}

static int64_t settled(const uint8_t *torn, int64_t size, int64_t *places)
{
    int64_t count = 0, since = 0;
    for (int64_t t = 0; t < size; t++) {
        since = !t || torn[t] ? 0 : since + 1;
        if (since >= SETTLING && t + 1 < size && !torn[t + 1]) places[count++] = t;
    }
    return count;
}

static int64_t link_rows(const int64_t *rows, int count, int64_t size, const uint8_t *torn, const tables *t,
                         double enough, double factor, room *r, int64_t *out, double *energies, int64_t *totals)
{
    int64_t *places = r->e + size, used = settled(torn, size, places);
    for (int i = 0; i < count; i++) {
        linear l;
        filter f;
        step_back(rows + i * size, size, r->y);
        for (int64_t at = 0; at < size; at++)
            if (torn[at]) r->y[at] = 0;
        predict_from(r->y, size, FIRST_ORDERS, 1, t, &l);
        filter_of(&f, &l, largest_of(r->y, size));
        for (int64_t from = 0; from < size; from += PIECE)
            some_errors(&f, r->y, from, size - from < PIECE ? size - from : PIECE, r->e + from);
        totals[i] = 0;
        for (int64_t at = 0; at < used; at++) {
            r->e[at] = r->e[places[at]];
            totals[i] += r->e[at] < 0 ? -r->e[at] : r->e[at];
        }
        shifts_of(r->e, used, r->shifts);
        scale(r->e, used, r->shifts, r->scaled + i * size);
        for (int j = 0; j <= i; j++)
            shifted_sums(r->scaled + i * size, r->scaled + j * size, used, r->sums[i * count + j]);
        choose_sources((const shifted *)r->sums, count, i, used, enough, factor, out + (SOURCES + 1) * i,
                       energies + 2 * i);
    }
    return used;
}

/* (rows int64 [count, size], torn uint8 [size], sines int32 [128], limits float64 [127], enough, factor,
   found int64 [count, 9], energies float64 [count, 2], totals int64 [count]) -> samples used */
static PyObject *find_links(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer rows, torn, sines, limits, found, energies, totals;
    double enough, factor;
    int64_t used = 0;
    if (!PyArg_ParseTuple(args, "y*y*y*y*ddw*w*w*", &rows, &torn, &sines, &limits, &enough, &factor, &found,
                          &energies, &totals))
        return NULL;
    PyObject *result = NULL;
    int64_t count = totals.len / 8, size = torn.len;
    int fits = whole(&rows, 8) && whole(&sines, 4) && whole(&limits, 8) && whole(&found, 8) &&
               whole(&energies, 8) && whole(&totals, 8) && count > 0 && count <= COMPONENTS && size > 0 &&
               size <= SPAN_MOST && rows.len == 8 * count * size && sines.len == 4 * 128 &&
               limits.len == 8 * 127 && found.len == 8 * (SOURCES + 1) * count &&
               energies.len == 16 * count && within(rows.buf, count * size, INDEX_LIMIT / 2);
    if (!fits) PyErr_SetString(PyExc_ValueError, "not rows of indices, or no room for their links");
    else {
        room r;
        int memory;
        Py_BEGIN_ALLOW_THREADS
        tables t = {sines.buf, limits.buf};
        memory = room_open(&r, count, size, 2);
        if (memory)
            used = link_rows(rows.buf, (int)count, size, torn.buf, &t, enough, factor, &r, found.buf,
                             energies.buf, totals.buf);
        room_close(&r);
        Py_END_ALLOW_THREADS
        result = memory ? PyLong_FromLongLong(used) : PyErr_NoMemory();
    }
    PyBuffer_Release(&rows);
    PyBuffer_Release(&torn);
    PyBuffer_Release(&sines);
    PyBuffer_Release(&limits);
    PyBuffer_Release(&found);
    PyBuffer_Release(&energies);
    PyBuffer_Release(&totals);
    return result;
}

/* ---- the weights of a packet ---- */

/* A target, the last row, and its sources: differences [count + 1, size], and the errors that are
   looked at. */
typedef struct {
    int count;
    int64_t size, used;
    int64_t largest[SOURCES + 1];
    int8_t weights[SOURCES * TAPS];
    room r;
} packet;

INLINE int64_t stride_of(int64_t size) { return size > ENOUGH ? size / ENOUGH + 1 : 1; }

static void look(packet *p, const linear *l)
{
    int64_t stride = stride_of(p->size), first = SETTLING < p->size / 2 ? SETTLING : p->size / 2;
    for (int i = 0; i <= p->count; i++) {
        filter f;
        const int64_t *y = p->r.y + i * p->size;
        int64_t *e = p->r.e + i * p->size;
        p->used = 0;
        filter_of(&f, l, p->largest[i]);
        for (int64_t from = 0; from < p->size; from += stride * STRETCH) {
            int64_t begin = from < first ? first : from, end = from + STRETCH < p->size ? from + STRETCH : p->size;
            if (begin >= end) continue;
            some_errors(&f, y, begin, end - begin, e + p->used);
            p->used += end - begin;
        }
    }
}

static void weigh(packet *p)
{
    int rows = p->count + 1, last = TAPS * p->count, sources[SOURCES];
    double m[SIZE][SIZE];
    shifts_of(p->r.e + p->count * p->size, p->used, p->r.shifts);
    for (int i = 0; i < rows; i++) {
        sources[i % SOURCES] = i;
        scale(p->r.e + i * p->size, p->used, p->r.shifts, p->r.scaled + i * p->size);
        for (int j = 0; j <= i; j++)
            shifted_sums(p->r.scaled + i * p->size, p->r.scaled + j * p->size, p->used, p->r.sums[i * rows + j]);
    }
    for (int i = 0; i < p->count; i++) sources[i] = i;
    moments_of((const shifted *)p->r.sums, rows, sources, p->count, p->count, p->used, m);
    for (int k = 0; k < last; k++) sweep_row(m, last + 1, k);
    for (int k = 0; k < last; k++) {
        double weight = floor((1 << WEIGHT_BITS) * m[k][last] + 0.5);
        p->weights[k] = (int8_t)(weight < -128 ? -128 : weight > 127 ? 127 : weight);
    }
}

/* out += weights of source i times its row around each place, nothing beyond the ends. */
static void add_taps(const int8_t *w, const int64_t *x, int64_t size, int64_t *out)
{
    for (int64_t t = 0; t < size; t++) {
        int64_t before = t ? x[t - 1] : 0, after = t + 1 < size ? x[t + 1] : 0;
        out[t] += w[0] * before + w[1] * x[t] + w[2] * after;
    }
}

/* 256 times about the bits of errors, by the mean of each block; in the twin's order. */
static int64_t cost_of(const int64_t *e, int64_t size)
{
    int64_t cost = 0;
    for (int64_t at = 0; at < size; at += LOUDNESS) {
        int64_t n = size - at < LOUDNESS ? size - at : LOUDNESS;
        uint64_t sum = 0;
        for (int64_t i = at; i < at + n; i++) sum += (uint64_t)(e[i] < 0 ? -e[i] : e[i]);
        cost += n * (log_of(32 * (uint64_t)n + 87 * sum) - log_of(32 * (uint64_t)n));
    }
    return cost;
}

/* The predictor of what the sources leave, and their weights. costs: without and with them. */
static void refer_to(packet *p, const tables *t, linear *l, int64_t *cross, int64_t *costs)
{
    int64_t *own = p->r.y + p->count * p->size, *left = cross;
    predict_from(own, p->size, ORDERS, 0, t, l);
    look(p, l);
    costs[0] = cost_of(p->r.e + p->count * p->size, p->used);
    weigh(p);
    memset(left, 0, (size_t)p->size * sizeof *left);
    for (int i = 0; i < p->count; i++) add_taps(p->weights + TAPS * i, p->r.y + i * p->size, p->size, left);
    for (int64_t i = 0; i < p->size; i++) left[i] = (own[i] * (1 << WEIGHT_BITS)) - left[i];
    predict_from(left, p->size, ORDERS, 0, t, l);
    look(p, l);
    weigh(p);
    int64_t *rest = p->r.e + p->count * p->size;
    memset(cross, 0, (size_t)p->used * sizeof *cross);
    for (int i = 0; i < p->count; i++) add_taps(p->weights + TAPS * i, p->r.e + i * p->size, p->used, cross);
    for (int64_t i = 0; i < p->used; i++) rest[i] -= (cross[i] + (1 << (WEIGHT_BITS - 1))) >> WEIGHT_BITS;
    costs[1] = cost_of(rest, p->used);
    memset(cross, 0, (size_t)p->size * sizeof *cross);
    for (int i = 0; i < p->count; i++) {
        filter f;
        int64_t *e = p->r.e;
        filter_of(&f, l, p->largest[i]);
        for (int64_t from = 0; from < p->size; from += PIECE)
            some_errors(&f, p->r.y + i * p->size, from, p->size - from < PIECE ? p->size - from : PIECE, e + from);
        add_taps(p->weights + TAPS * i, e, p->size, cross);
    }
    for (int64_t i = 0; i < p->size; i++) cross[i] = (cross[i] + (1 << (WEIGHT_BITS - 1))) >> WEIGHT_BITS;
}

/* (rows int64 [any, size], target, sources bytes, sines int32 [128], limits float64 [127], reflections int8
   [32], weights int8 [sources, 3], cross int64 [size]) -> (order, 256 times about the bits without them,
   and with them, samples that these are of) */
static PyObject *refer(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer rows, sources, sines, limits, reflections, weights, cross;
    int target;
    int64_t costs[2] = {0};
    linear l;
    if (!PyArg_ParseTuple(args, "y*iy*y*y*w*w*w*", &rows, &target, &sources, &sines, &limits, &reflections,
                          &weights, &cross))
        return NULL;
    PyObject *result = NULL;
    packet p;
    p.count = (int)sources.len;
    p.size = cross.len / 8;
    const uint8_t *a = sources.buf;
    int64_t there = p.size ? rows.len / 8 / p.size : 0;
    int fits = whole(&rows, 8) && whole(&sines, 4) && whole(&limits, 8) && whole(&cross, 8) && p.size > 1 &&
               p.size <= SPAN_MOST && rows.len == 8 * there * p.size && target >= 0 && target < there &&
               sources.len > 0 && sources.len <= SOURCES && sines.len == 4 * 128 && limits.len == 8 * 127 &&
               reflections.len == ORDERS && weights.len == TAPS * sources.len;
    for (int i = 0; fits && i < p.count; i++) fits = a[i] < target && (!i || a[i - 1] < a[i]);
    for (int i = 0; fits && i <= p.count; i++)
        fits = within((const int64_t *)rows.buf + (i < p.count ? a[i] : target) * p.size, p.size, INDEX_LIMIT);
    if (!fits) PyErr_SetString(PyExc_ValueError, "not rows of indices, or no sources among them");
    else {
        int memory;
        Py_BEGIN_ALLOW_THREADS
        tables t = {sines.buf, limits.buf};
        memory = room_open(&p.r, p.count + 1, p.size, p.count + 1);
        if (memory) {
            for (int i = 0; i <= p.count; i++) {
                const int64_t *x = (const int64_t *)rows.buf + (i < p.count ? a[i] : target) * p.size;
                step_back(x, p.size, p.r.y + i * p.size);
                p.largest[i] = largest_of(p.r.y + i * p.size, p.size);
            }
            refer_to(&p, &t, &l, cross.buf, costs);
            memcpy(reflections.buf, l.reflections, ORDERS);
            memcpy(weights.buf, p.weights, (size_t)(TAPS * p.count));
        }
        room_close(&p.r);
        Py_END_ALLOW_THREADS
        if (memory) result = Py_BuildValue("iLLL", l.order, (long long)costs[0], (long long)costs[1], (long long)p.used);
        else PyErr_NoMemory();
    }
    PyBuffer_Release(&rows);
    PyBuffer_Release(&sources);
    PyBuffer_Release(&sines);
    PyBuffer_Release(&limits);
    PyBuffer_Release(&reflections);
    PyBuffer_Release(&weights);
    PyBuffer_Release(&cross);
    return result;
}

PyMethodDef hapfmt_references_methods[] = {
    {"find_links", find_links, METH_VARARGS, NULL},
    {"refer", refer, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
