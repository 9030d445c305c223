/* LPCR: the functions that Python calls, each with a readable twin there. No Python object is touched
   while the GIL is released, nothing is allocated in a loop, and arguments are checked here. */
#include "kernels.h"

#include "components.h"
#include "search.h"

class_table hapfmt_classes[CLASSES];
uint64_t hapfmt_inverses[SCALE + 1];
uint16_t hapfmt_costs[SCALE];
models hapfmt_models;
flag_tables hapfmt_flags;

/* Rows of SPEC 9.4: shape, scale, zeros, half. */
static const int8_t rows[CLASSES][4] = {
    {8, 38, 0, 0},  {32, 24, 0, 0}, {-4, 38, 0, 0}, {-7, 24, -1, 0}, {64, 14, 0, 0}, {8, 38, 0, 1},
    {16, 76, 32, 0}, {0, 38, 0, 1},  {32, 17, 0, 0}, {8, 28, 0, 1},  {8, 14, 0, 1},  {-4, 76, 0, 1},
    {-6, 38, 0, 0}, {16, 24, -1, 0}, {64, 24, 0, 0}, {0, 14, 0, 1},
};

static void build_context(const int8_t *row, int c, class_table *t)
{
    int lg = (c + 8) / 4, fr = (c + 8) % 4, shape = row[0];
    int64_t mean = (((9 + 2 * fr) << lg) / 8 + 1) * row[1] / 64 + 1, ratio = 65536 * mean / (mean + 256);
    int64_t g = 65536, least = 0, from = 0;
    for (int w = 1, k = 1; k < SYMBOLS; w++) {
        g = w == 1 && row[3] ? (int64_t)sqrt((double)(65536 * ratio)) : g * ratio / 65536;
        if (w < edges[k]) continue;
        int64_t tail = (8 + shape) * g * 65536 / (8 * 65536 + shape * g);
        if (k == 1) least = tail;
        tail = row[2] < 0 ? tail * 64512 / (least ? least : 1) : tail * (64 - row[2]) / 64;
        if (tail > 65535) tail = 65535;
        int64_t to = k + (65536 - tail) * (SCALE - 16) / 65536;
        t->shares[c][k - 1].first = (uint16_t)from;
        t->shares[c][k - 1].width = (uint16_t)(to - from);
        from = to;
        k++;
    }
    t->shares[c][ESCAPE].first = (uint16_t)from;
    t->shares[c][ESCAPE].width = (uint16_t)(SCALE - from);
    for (int i = 0, k = 0; i < 1 << COARSE_BITS; i++) {
        while (k < ESCAPE && i << FINE_BITS >= t->shares[c][k + 1].first) k++;
        t->symbols[c][i] = (uint8_t)k;
        t->coarse[c][i] = t->shares[c][k];
    }
    for (int k = 0; k < SYMBOLS; k++) {
        share s = t->shares[c][k];
        t->costs[c][k] = (uint16_t)floor(256 * log2((double)SCALE / s.width) + 0.5);
    }
}

/* (bytes or writable buffer, coefficients int32, difference, repeats, base, limit, cross int64, as many as indices or none, indices int64) -> (status, bytes read or written) */
static PyObject *run(PyObject *args, int decoding)
{
    Py_buffer data, coefficients, cross, indices;
    plan p = {0};
    int status = NO_ROOM, memory = 1;
    long long base, limit;
    int64_t size = 0;
    const char *format = decoding ? "y*y*ipLLy*w*" : "w*y*ipLLy*y*";
    if (!PyArg_ParseTuple(args, format, &data, &coefficients, &p.difference, &p.repeats,
                          &base, &limit, &cross, &indices))
        return NULL;
    PyObject *result = NULL;
    p.order = coefficients.len > 4 * ORDERS ? ORDERS + 1 : (int)(coefficients.len / 4);
    p.base = base;
    p.limit = limit;
    p.span = indices.len / 8;
    p.coefficients = coefficients.buf;
    p.cross = cross.len ? cross.buf : NULL;
    if (!whole(&coefficients, 4) || !whole(&indices, 8) || !p.span || !valid(&p) ||
        (p.cross && (!whole(&cross, 8) || cross.len != indices.len ||
                     !within(p.cross, p.span, CROSS_LIMIT))))
        PyErr_SetString(PyExc_ValueError, "not a predictor, or not arrays of its integers");
    else {
        Py_BEGIN_ALLOW_THREADS
        if (decoding) {
            uint8_t *copy = with_margins(data.buf, data.len);
            uint8_t *same = p.repeats ? malloc((size_t)p.span) : NULL;
            memory = copy && (same || !p.repeats);
            if (memory) status = decode(copy + MARGIN, data.len, &p, same, indices.buf, &size);
            free(same);
            free(copy);
        } else {
            workshop w;
            memory = workshop_open(&w, p.span);
            if (memory) status = encode(&w, &p, indices.buf, data.buf, data.len, &size);
            memory = memory && status != NO_MEMORY;
            workshop_close(&w);
        }
        Py_END_ALLOW_THREADS
        if (memory) result = Py_BuildValue("iL", status, (long long)size);
        else PyErr_NoMemory();
    }
    PyBuffer_Release(&data);
    PyBuffer_Release(&coefficients);
    PyBuffer_Release(&cross);
    PyBuffer_Release(&indices);
    return result;
}

static PyObject *lpcr_decode(PyObject *self, PyObject *args) { (void)self; return run(args, 1); }
static PyObject *lpcr_encode(PyObject *self, PyObject *args) { (void)self; return run(args, 0); }

/* (packet, components, largest index, step, zero, magnitudes of a deadband's grid int64 or none, least
   and largest count, sines int32 [128], counts int32 [components, ticks]) -> 0: it breaks a rule, 1: all
   counts lie within the range, 2: some were moved into it */
static PyObject *lpcr_packet(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer packet, levels, sines, counts;
    int count, status = -1;
    long long limit, step, zero, low, high;
    if (!PyArg_ParseTuple(args, "y*iLLLy*LLy*w*", &packet, &count, &limit, &step, &zero, &levels, &low, &high,
                          &sines, &counts))
        return NULL;
    PyObject *result = NULL;
    const int64_t bound = (int64_t)1 << 31;
    scale s = {levels.len ? levels.buf : NULL, limit, step, zero, low, high};
    int64_t span = count > 0 ? counts.len / 4 / count : 0;
    int fits = count >= 1 && count <= COMPONENTS_MOST && span >= 1 && counts.len == 4 * count * span &&
               whole(&counts, 4) && whole(&levels, 8) && whole(&sines, 4) && sines.len == 4 * 128 &&
               limit >= 0 && limit <= INDEX_LIMIT && step >= 1 && step <= bound && zero >= -bound &&
               zero < bound && low <= high && low >= -bound && high < bound &&
               (levels.len ? levels.len / 8 > limit : step * limit <= INDEX_LIMIT);
    for (int i = 0; fits && i < 128; i++) {
        int32_t sine = ((int32_t *)sines.buf)[i];
        fits = sine >= 0 && sine < 32768;
    }
    if (!fits) PyErr_SetString(PyExc_ValueError, "not a grid, or not the counts of components");
    else {
        bytes b = {packet.buf, packet.len};
        Py_BEGIN_ALLOW_THREADS
        status = decode_packet(b, count, span, &s, sines.buf, counts.buf);
        Py_END_ALLOW_THREADS
        if (status >= 0) result = PyLong_FromLong(status);
        else PyErr_NoMemory();
    }
    PyBuffer_Release(&packet);
    PyBuffer_Release(&levels);
    PyBuffer_Release(&sines);
    PyBuffer_Release(&counts);
    return result;
}

/* (coefficients int32, difference, base, limit, indices int64, errors int64) */
static PyObject *lpcr_errors(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer coefficients, indices, errors;
    plan p = {0};
    long long base, limit;
    if (!PyArg_ParseTuple(args, "y*iLLy*w*", &coefficients, &p.difference, &base, &limit, &indices,
                          &errors))
        return NULL;
    PyObject *result = NULL;
    p.order = coefficients.len > 4 * ORDERS ? ORDERS + 1 : (int)(coefficients.len / 4);
    p.base = base;
    p.limit = limit;
    p.span = indices.len / 8;
    p.coefficients = coefficients.buf;
    if (!whole(&coefficients, 4) || !whole(&indices, 8) || !whole(&errors, 8) ||
        errors.len != indices.len || !valid(&p) || !within(indices.buf, p.span, p.limit))
        PyErr_SetString(PyExc_ValueError, "not a predictor, or not arrays of its integers");
    else {
        Py_BEGIN_ALLOW_THREADS
        prediction_errors(&p, indices.buf, errors.buf);
        Py_END_ALLOW_THREADS
        Py_INCREF(Py_None);
        result = Py_None;
    }
    PyBuffer_Release(&coefficients);
    PyBuffer_Release(&indices);
    PyBuffer_Release(&errors);
    return result;
}

/* (reflections int8, sines int32, coefficients int32) -> whether LPC-005 holds */
static PyObject *step_up_(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer reflections, sines, out;
    if (!PyArg_ParseTuple(args, "y*y*w*", &reflections, &sines, &out)) return NULL;
    PyObject *result = NULL;
    int8_t *k = reflections.buf;
    int fits = reflections.len <= ORDERS && out.len == 4 * reflections.len && sines.len == 4 * 128 &&
               whole(&sines, 4) && whole(&out, 4);
    for (int i = 0; fits && i < reflections.len; i++) fits = k[i] > -128;
    for (int i = 0; fits && i < 128; i++) {
        int32_t sine = ((int32_t *)sines.buf)[i];
        fits = sine >= 0 && sine < 32768;
    }
    if (!fits) PyErr_SetString(PyExc_ValueError, "not reflection coefficients");
    else result = PyBool_FromLong(step_up(k, (int)reflections.len, sines.buf, out.buf));
    PyBuffer_Release(&reflections);
    PyBuffer_Release(&sines);
    PyBuffer_Release(&out);
    return result;
}

/* (indices int64, difference, base, sums int64 [33]) */
static PyObject *autocorrelate_(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer indices, sums;
    plan p = {0};
    long long base;
    if (!PyArg_ParseTuple(args, "y*iLw*", &indices, &p.difference, &base, &sums)) return NULL;
    PyObject *result = NULL;
    p.base = base;
    p.limit = INDEX_LIMIT;
    if (!whole(&indices, 8) || !whole(&sums, 8) || sums.len != 8 * LAGS || !valid(&p) ||
        !within(indices.buf, indices.len / 8, INDEX_LIMIT))
        PyErr_SetString(PyExc_ValueError, "not indices, or no room for their sums");
    else {
        Py_BEGIN_ALLOW_THREADS
        autocorrelate(indices.buf, indices.len / 8, p.difference, p.base, LAGS, sums.buf);
        Py_END_ALLOW_THREADS
        Py_INCREF(Py_None);
        result = Py_None;
    }
    PyBuffer_Release(&indices);
    PyBuffer_Release(&sums);
    return result;
}

/* (sums float64 [33], orders, limits float64 [127], reflections int8 [32], energies float64 [32]) ->
   how many there are */
static PyObject *levinson_(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer sums, limits, found, energies;
    int orders;
    if (!PyArg_ParseTuple(args, "y*iy*w*w*", &sums, &orders, &limits, &found, &energies)) return NULL;
    PyObject *result = NULL;
    if (!whole(&sums, 8) || !whole(&limits, 8) || !whole(&energies, 8) || sums.len != 8 * LAGS ||
        limits.len != 8 * 127 || found.len != ORDERS || energies.len != 8 * ORDERS || orders < 0 ||
        orders > ORDERS)
        PyErr_SetString(PyExc_ValueError, "not the arrays of a recursion of order 32");
    else
        result = PyLong_FromLong(levinson(sums.buf, orders, limits.buf, found.buf, energies.buf));
    PyBuffer_Release(&sums);
    PyBuffer_Release(&limits);
    PyBuffer_Release(&found);
    PyBuffer_Release(&energies);
    return result;
}

PyMethodDef hapfmt_lpcr_methods[] = {
    {"lpcr_decode", lpcr_decode, METH_VARARGS, NULL},
    {"lpcr_packet", lpcr_packet, METH_VARARGS, NULL},
    {"lpcr_encode", lpcr_encode, METH_VARARGS, NULL},
    {"lpcr_errors", lpcr_errors, METH_VARARGS, NULL},
    {"step_up", step_up_, METH_VARARGS, NULL},
    {"autocorrelate", autocorrelate_, METH_VARARGS, NULL},
    {"levinson", levinson_, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

void hapfmt_lpcr_prepare(void)
{
    for (int i = 1; i <= SCALE; i++)
        hapfmt_inverses[i] = (((uint64_t)1 << 44) + (uint64_t)i - 1) / (uint64_t)i;
    for (int i = 1; i < SCALE; i++)
        hapfmt_costs[i] = (uint16_t)floor(256 * log2((double)SCALE / i) + 0.5);
    models_prepare(&hapfmt_models);
    flag_tables_prepare(&hapfmt_flags);
    for (int i = 0; i < CLASSES; i++)
        for (int c = 0; c < CONTEXTS; c++) build_context(rows[i], c, hapfmt_classes + i);
}
