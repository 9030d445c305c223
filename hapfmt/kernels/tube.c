/* Knots in an integer tube: the functions of the module, and held values. The readable twin is
   hapfmt/encoder/tube.py; lines are in links.c. */
#include "tube.h"

enum { TICK_LIMIT = 1 << 24, AXES = 256 };
static const int64_t COUNT_BOUND = (int64_t)1 << 32, VALUE_BOUND = (int64_t)1 << 34;

/* How many knots. */
static int64_t fewest_hold(const tube *in, int64_t *ticks, int64_t *values)
{
    int64_t low = -COUNT_BOUND, high = COUNT_BOUND, first_low = 0, first_high = 0, value = 0;
    int64_t count = 0;
    int32_t start = 0;
    for (int32_t t = 0; t <= in->size; t++) {
        if (t < in->size && in->lower[t] <= high && in->upper[t] >= low) {
            if (in->lower[t] > low) low = in->lower[t];
            if (in->upper[t] < high) high = in->upper[t];
            continue;
        }
        /* The first piece takes the value closest to the middle of the second one. */
        if (count == 0) {
            first_low = low;
            first_high = high;
        }
        if (count < 2) value = (low + high) >> 1;
        if (count == 1) values[0] = value = clamp(value, first_low, first_high);
        ticks[count] = start;
        values[count++] = value = clamp(value, low, high);
        if (t < in->size) {
            start = t;
            low = in->lower[t];
            high = in->upper[t];
        }
    }
    return count;
}

static int is_row(const Py_buffer *row, Py_ssize_t size)
{
    return row->len == 8 * size && (uintptr_t)row->buf % 8 == 0;
}

static int is_tube(const Py_buffer *lower, const Py_buffer *upper, Py_ssize_t size)
{
    int fits = is_row(lower, size) && is_row(upper, size);
    for (Py_ssize_t t = 0; fits && t < size; t++) {
        int64_t low = ((const int64_t *)lower->buf)[t], high = ((const int64_t *)upper->buf)[t];
        fits = -COUNT_BOUND <= low && low <= high && high <= COUNT_BOUND;
    }
    return fits;
}

/* A tube, and two rows as long. */
static int are_rows(const Py_buffer *each)
{
    Py_ssize_t size = each[0].len / 8;
    return size > 0 && size <= TICK_LIMIT && is_row(&each[2], size) && is_row(&each[3], size) &&
           is_tube(&each[0], &each[1], size);
}

static int is_grid(const grid *g, const Py_buffer *levels)
{
    if (!g->levels)
        return g->count > 0 && g->step > 0 && g->first >= -VALUE_BOUND && g->first <= VALUE_BOUND &&
               g->count - 1 <= (VALUE_BOUND - g->first) / g->step;
    int fits = g->count == levels->len / 8 && levels->len % 8 == 0;
    fits = fits && g->count > 0 && (uintptr_t)levels->buf % 8 == 0;
    for (int64_t i = 0; fits && i < g->count; i++)
        fits = i ? g->levels[i - 1] < g->levels[i] : g->levels[0] >= -VALUE_BOUND;
    return fits && g->levels[g->count - 1] <= VALUE_BOUND;
}

static PyObject *answer(int fits, int64_t count)
{
    if (!fits)
        PyErr_SetString(PyExc_ValueError, "not a tube of 64-bit integers, no grid, or no room for knots");
    if (fits && count < 0) return PyErr_NoMemory();
    return fits ? PyLong_FromLongLong(count) : NULL;
}

/* (lower, upper, ticks, values: int64 [ticks], the last two are filled) -> number of knots */
static PyObject *hold(PyObject *self, PyObject *args)
{
    Py_buffer each[4];
    int64_t count = 0;
    int fits;
    (void)self;
    if (!PyArg_ParseTuple(args, "y*y*w*w*", &each[0], &each[1], &each[2], &each[3])) return NULL;
    Py_BEGIN_ALLOW_THREADS
    fits = are_rows(each);
    if (fits) {
        tube in = {each[0].buf, each[1].buf, (int32_t)(each[0].len / 8)};
        count = fewest_hold(&in, each[2].buf, each[3].buf);
    }
    Py_END_ALLOW_THREADS
    for (int i = 0; i < 4; i++) PyBuffer_Release(&each[i]);
    return answer(fits, count);
}

/* (lower, upper, first, step, count, levels, ticks, values) -> number of knots. levels: int64
   [count], or empty for the values first + step * place; the others as above. */
static PyObject *linear(PyObject *self, PyObject *args)
{
    Py_buffer each[4], levels;
    long long first, step, size;
    int64_t count = 0;
    int fits;
    (void)self;
    if (!PyArg_ParseTuple(args, "y*y*LLLy*w*w*", &each[0], &each[1], &first, &step, &size, &levels,
                          &each[2], &each[3]))
        return NULL;
    Py_BEGIN_ALLOW_THREADS
    grid g = {levels.len ? levels.buf : NULL, first, step, size};
    fits = are_rows(each) && is_grid(&g, &levels);
    if (fits) {
        tube in = {each[0].buf, each[1].buf, (int32_t)(each[0].len / 8)};
        count = hapfmt_fewest_linear(&in, &g, each[2].buf, each[3].buf);
    }
    Py_END_ALLOW_THREADS
    for (int i = 0; i < 4; i++) PyBuffer_Release(&each[i]);
    PyBuffer_Release(&levels);
    return answer(fits, count);
}

/* (lower, upper, grids, ticks, places) -> number of knots. lower, upper: int64 [axes, ticks]; grids:
   int64 [axes, 3], first, step and count of values; ticks [ticks] and places [ticks, axes] are filled
   from their end. */
static PyObject *joined(PyObject *self, PyObject *args)
{
    Py_buffer each[5];
    tube tubes[AXES];
    grid grids[AXES];
    int64_t count = 0;
    int fits;
    (void)self;
    if (!PyArg_ParseTuple(args, "y*y*y*w*w*", &each[0], &each[1], &each[2], &each[3], &each[4]))
        return NULL;
    Py_BEGIN_ALLOW_THREADS
    Py_ssize_t axes = each[2].len / 24, size = each[3].len / 8;
    fits = axes > 0 && axes <= AXES && size > 0 && size <= TICK_LIMIT;
    fits = fits && is_row(&each[2], 3 * axes) && is_row(&each[3], size) &&
           is_row(&each[4], size * axes) && is_tube(&each[0], &each[1], size * axes);
    for (Py_ssize_t a = 0; fits && a < axes; a++) {
        const int64_t *shape = (const int64_t *)each[2].buf + 3 * a;
        tube t = {(const int64_t *)each[0].buf + a * size, (const int64_t *)each[1].buf + a * size,
                  (int32_t)size};
        grid g = {NULL, shape[0], shape[1], shape[2]};
        tubes[a] = t;
        grids[a] = g;
        fits = is_grid(&g, NULL);
    }
    if (fits) count = hapfmt_fewest_joined(tubes, grids, (int)axes, each[3].buf, each[4].buf);
    Py_END_ALLOW_THREADS
    for (int i = 0; i < 5; i++) PyBuffer_Release(&each[i]);
    return answer(fits, count);
}

PyMethodDef hapfmt_tube_methods[] = {
    {"fewest_hold", hold, METH_VARARGS, NULL},
    {"fewest_linear", linear, METH_VARARGS, NULL},
    {"fewest_joined", joined, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
