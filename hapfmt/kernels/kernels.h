/* Shared by all files of the extension module: the limited API, and the tables of functions. */
#ifndef HAPFMT_KERNELS_H
#define HAPFMT_KERNELS_H

#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdint.h>
#include <string.h>

extern PyMethodDef hapfmt_lpcr_methods[];
extern PyMethodDef hapfmt_tube_methods[];
extern PyMethodDef hapfmt_knots_methods[];
extern PyMethodDef hapfmt_select_methods[];
extern PyMethodDef hapfmt_huffman_methods[];
extern PyMethodDef hapfmt_levels_methods[];
extern PyMethodDef hapfmt_exact_methods[];
extern PyMethodDef hapfmt_knots_coded_methods[];
extern PyMethodDef hapfmt_packet_methods[];
extern PyMethodDef hapfmt_deflate_methods[];
extern PyMethodDef hapfmt_references_methods[];
extern PyMethodDef hapfmt_transform_methods[];
extern PyMethodDef hapfmt_trellis_methods[];
extern PyMethodDef hapfmt_noise_methods[];
extern PyMethodDef hapfmt_sections_methods[];
extern PyMethodDef hapfmt_lattice_methods[];
void hapfmt_lpcr_prepare(void);

/* Whether a buffer is a row of numbers, each of the given size in bytes. */
static inline int whole(const Py_buffer *buffer, Py_ssize_t size)
{
    return buffer->len % size == 0 && (uintptr_t)buffer->buf % (uintptr_t)size == 0;
}

#endif
