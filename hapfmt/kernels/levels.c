/* Grids of counts (SPEC 9.1): the levels of a deadband, up to 8813 of them, and the counts of a uniform
   one, clamped. The readable twins are deadband_levels of hapfmt/codecs/grids.py, and decode_within of
   predicted.py. Widths of levels: below the bound, 2^32, times 2^16. */
#include "kernels.h"

static const int64_t BOUND = (int64_t)1 << 32;

static int64_t grow(int64_t step, int64_t kn, int64_t kd, int64_t bound, int64_t room,
                    int64_t *levels, int64_t *tops)
{
    int64_t y = 0, left = kd - kn;
    for (int64_t count = 0; count < room;) {
        int64_t top = y + step, c;
        if (left <= 0) top = bound;
        else if (y * kd / left > top) top = y * kd / left;
        levels[count] = y;
        tops[count++] = top;
        if (top >= bound) return count;
        c = top + 1;
        y = c + (kn * c / kd > step ? kn * c / kd : step);
    }
    return -1;
}

/* (step, kn, kd, bound, levels and tops: int64, filled) -> how many; -1: more than there is room */
static PyObject *deadband_levels(PyObject *self, PyObject *args)
{
    Py_buffer levels, tops;
    long long step, kn, kd, bound, count = -1;
    (void)self;
    if (!PyArg_ParseTuple(args, "LLLLw*w*", &step, &kn, &kd, &bound, &levels, &tops)) return NULL;
    int fits = step >= 0 && step <= BOUND && kn > 0 && kn < 65536 && kd > 0 && kd < 65536 &&
               bound >= 0 && bound <= BOUND && levels.len == tops.len && whole(&levels, 8) &&
               whole(&tops, 8);
    if (fits) {
        Py_BEGIN_ALLOW_THREADS
        count = grow(step, kn, kd, bound, levels.len / 8, levels.buf, tops.buf);
        Py_END_ALLOW_THREADS
    } else
        PyErr_SetString(PyExc_ValueError, "not a deadband's grid, or not two equal rows");
    PyBuffer_Release(&levels);
    PyBuffer_Release(&tops);
    return fits ? PyLong_FromLongLong(count) : NULL;
}

/* (int64 numbers, step, zero, low, high, int32 counts): numbers * step + zero within [low, high]; the
   caller knows that the products fit. */
static PyObject *clamp_counts(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer numbers, counts;
    long long step, zero, low, high;
    if (!PyArg_ParseTuple(args, "y*LLLLw*", &numbers, &step, &zero, &low, &high, &counts)) return NULL;
    PyObject *result = NULL;
    const int64_t bound = (int64_t)1 << 31;
    if (!whole(&numbers, 8) || !whole(&counts, 4) || counts.len * 2 != numbers.len || low > high ||
        low < -bound || high >= bound)
        PyErr_SetString(PyExc_ValueError, "not numbers and as many counts");
    else {
        const int64_t *from = numbers.buf;
        int32_t *to = counts.buf;
        Py_ssize_t size = counts.len / 4;
        Py_BEGIN_ALLOW_THREADS
        for (Py_ssize_t i = 0; i < size; i++) {
            int64_t v = (int64_t)((uint64_t)from[i] * (uint64_t)step + (uint64_t)zero);
            v = v < low ? low : v;
            to[i] = (int32_t)(v > high ? high : v);
        }
        Py_END_ALLOW_THREADS
        Py_INCREF(Py_None);
        result = Py_None;
    }
    PyBuffer_Release(&numbers);
    PyBuffer_Release(&counts);
    return result;
}

PyMethodDef hapfmt_levels_methods[] = {
    {"deadband_levels", deadband_levels, METH_VARARGS, NULL},
    {"clamp_counts", clamp_counts, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
