/* The hot loops in C99; every one has a readable twin in Python. No Python object is touched while
   the GIL is released, nothing is allocated in a loop, and arguments are checked here. */
#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "lpcr.h"

static int whole(const Py_buffer *buffer, Py_ssize_t size)
{
    return buffer->len % size == 0 && (uintptr_t)buffer->buf % (uintptr_t)size == 0;
}

/* (bytes or writable buffer, coefficients int32, difference, repeats, raw signs, base, limit,
   indices int64) -> (status, bytes read or written) */
static PyObject *run(PyObject *args, int decoding)
{
    Py_buffer data, coefficients, indices;
    plan p;
    int status = NO_ROOM;
    long long base, limit;
    int64_t size = 0;
    const char *format = decoding ? "y*y*ippLLw*" : "w*y*ippLLy*";
    if (!PyArg_ParseTuple(args, format, &data, &coefficients, &p.difference, &p.repeats,
                          &p.raw_signs, &base, &limit, &indices))
        return NULL;
    PyObject *result = NULL;
    models *m = PyMem_Malloc(sizeof *m);
    p.order = coefficients.len > 4 * ORDERS ? ORDERS + 1 : (int)(coefficients.len / 4);
    p.base = base;
    p.limit = limit;
    p.span = indices.len / 8;
    p.coefficients = coefficients.buf;
    if (!m)
        PyErr_NoMemory();
    else if (!whole(&coefficients, 4) || !whole(&indices, 8) || !valid(&p))
        PyErr_SetString(PyExc_ValueError, "not a predictor, or not arrays of its integers");
    else {
        Py_BEGIN_ALLOW_THREADS
        models_init(m);
        if (decoding) {
            decoder d;
            decoder_init(&d, data.buf, data.len);
            status = decode(&d, m, &p, indices.buf);
            size = (bits_taken(&d) - 15) / 8;
        } else {
            encoder e;
            encoder_init(&e, data.buf, data.len);
            status = encode(&e, m, &p, indices.buf, &size);
        }
        Py_END_ALLOW_THREADS
        result = Py_BuildValue("iL", status, (long long)size);
    }
    PyMem_Free(m);
    PyBuffer_Release(&data);
    PyBuffer_Release(&coefficients);
    PyBuffer_Release(&indices);
    return result;
}

static PyObject *lpcr_decode(PyObject *self, PyObject *args) { (void)self; return run(args, 1); }
static PyObject *lpcr_encode(PyObject *self, PyObject *args) { (void)self; return run(args, 0); }

static PyMethodDef methods[] = {
    {"lpcr_decode", lpcr_decode, METH_VARARGS, NULL},
    {"lpcr_encode", lpcr_encode, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_kernels", NULL, 0, methods,
                                    NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernels(void)
{
    build_tables();
    return PyModule_Create(&module);
}
