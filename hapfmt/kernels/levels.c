/* The levels of a deadband grid (SPEC 9.5), up to 8813 of them; the readable twin is
   deadband_levels of hapfmt/codecs/predicted.py. Widths: below the bound, 2^32, times 2^16. */
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
               bound >= 0 && bound <= BOUND && levels.len == tops.len && levels.len % 8 == 0 &&
               (uintptr_t)levels.buf % 8 == 0 && (uintptr_t)tops.buf % 8 == 0;
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

PyMethodDef hapfmt_levels_methods[] = {
    {"deadband_levels", deadband_levels, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
