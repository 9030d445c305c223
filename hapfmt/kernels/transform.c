/* MDCT: the functions that Python calls, each with a readable twin in hapfmt/codecs/transform.py. */
#include "kernels.h"

#include "transform.h"

/* Whether the buffers are those of blocks of one size, and say nothing that the loops were not made for. */
static int valid_transform(const transform *t, const Py_buffer *waves, const Py_buffer *pairs,
                           const Py_buffer *window, const Py_buffer *steps)
{
    Py_ssize_t size = t->size;
    int fits = size >= 32 && size <= SIZE_MOST && !(size & (size - 1)) && whole(waves, 8) &&
               whole(window, 8) && whole(steps, 8) && waves->len == 8 * size * size &&
               whole(pairs, 2) && pairs->len == 2 * size * size &&
               window->len == 8 * size && t->count >= 1 && t->count <= size && t->classes >= 0 &&
               t->classes < 256 && t->start >= 0 && t->start <= START_MOST &&
               t->base <= (int64_t)1 << 32 && t->base >= -((int64_t)1 << 32) && t->low <= t->high &&
               t->low >= INT32_MIN && t->high <= INT32_MAX;
    for (int k = 0; fits && k < t->count; k++)
        fits = t->steps[k] >= 1 && t->steps[k] < (int64_t)1 << 36;
    for (Py_ssize_t i = 0; fits && i < size; i++)
        fits = t->window[i] >= 0 && t->window[i] <= 1 << COSINE_BITS;
    return fits;
}

/* (coded bytes, waves float64 [size / 16, size, 16], pairs int16 [size / 16, size / 2, 16, 2], window int64 [2, size / 2], steps int64 [count], classes,
   start, base, least and largest count, counts int32) -> (status, bytes read) */
static PyObject *mdct_decode(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer coded, waves, pairs, window, steps, counts;
    transform t = {0};
    long long base, low, high;
    int64_t taken = 0;
    int status = NO_ROOM;
    uint8_t *copy = NULL;
    workbench *work = NULL;
    if (!PyArg_ParseTuple(args, "y*y*y*y*y*iiLLLw*", &coded, &waves, &pairs, &window, &steps,
                          &t.classes, &t.start, &base, &low, &high, &counts))
        return NULL;
    PyObject *result = NULL;
    t.size = window.len > 8 * SIZE_MOST ? 0 : (int)(window.len / 8);
    t.count = steps.len > 8 * SIZE_MOST ? 0 : (int)(steps.len / 8);
    t.waves = waves.buf;
    t.pairs = pairs.buf;
    t.window = window.buf;
    t.steps = steps.buf;
    t.base = base;
    t.low = low;
    t.high = high;
    t.span = counts.len / 4;
    if (!valid_transform(&t, &waves, &pairs, &window, &steps) || !whole(&counts, 4))
        PyErr_SetString(PyExc_ValueError, "not a transform, or not arrays of its numbers");
    else {
        Py_BEGIN_ALLOW_THREADS
        t.step = t.steps[0];
        for (int k = 1; k < t.count; k++)
            if (t.steps[k] != t.step) t.step = 0;
        copy = with_margins(coded.buf, coded.len);
        work = malloc(sizeof *work);
        if (copy && work)
            status = decode_transform(copy + MARGIN, coded.len, &t, work, counts.buf, &taken);
        Py_END_ALLOW_THREADS
        if (copy && work) result = Py_BuildValue("iL", status, (long long)taken);
        else PyErr_NoMemory();
        free(work);
        free(copy);
    }
    PyBuffer_Release(&coded);
    PyBuffer_Release(&waves);
    PyBuffer_Release(&pairs);
    PyBuffer_Release(&window);
    PyBuffer_Release(&steps);
    PyBuffer_Release(&counts);
    return result;
}

PyMethodDef hapfmt_transform_methods[] = {
    {"mdct_decode", mdct_decode, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
