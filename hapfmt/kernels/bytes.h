/* Bytes of a packet that are taken from the front. */
#ifndef HAPFMT_BYTES_H
#define HAPFMT_BYTES_H

#include <stdint.h>

typedef struct {
    const uint8_t *at;
    int64_t size; /* -1: it broke a rule */
} bytes;

/* CNV-002 */
static int64_t take_varint(bytes *b)
{
    uint64_t value = 0;
    for (int i = 0; i < 8 && i < b->size; i++) {
        uint8_t byte = b->at[i];
        value |= (uint64_t)(byte & 127) << 7 * i;
        if (byte < 128) {
            if ((!byte && i) || value >> 53) break;
            b->at += i + 1;
            b->size -= i + 1;
            return (int64_t)value;
        }
    }
    b->size = -1;
    return 0;
}

#endif
