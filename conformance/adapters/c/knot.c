/* A small decoder of hapf files, as an adapter of the conformance suite: codec KNOT, level 1.
 *
 *   cc -std=c99 -O2 -o knot knot.c
 *   python conformance/run.py --impl ./knot
 *
 * It shows how little a decoder needs, not all that one should do: it stops at the first damage, and of
 * the rules for files it checks what it would trip over. Clauses of SPEC.md are in parentheses. */
#include <inttypes.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { ERROR = 1, NONCONFORMING = 2, DAMAGED = 3, UNSUPPORTED = 4 }; /* clause 13 */
enum { HEADER = 32 }; /* bytes of a chunk header */
enum { TRACKS = 65534, COMPONENTS = 255, PAYLOAD = 1 << 20 };
enum { CLUSTER = 1 << 22, SPAN = 1 << 24, PACKETS = 1 << 14 };
enum { BOUND = 1 << 24 }; /* of counts, and of steps (15) */

typedef struct { const uint8_t *at, *end; } Bytes;
typedef struct { int64_t start, stop; } Span;
typedef struct {
    int described, kind, format, components, known;
    uint32_t rate[2];
    char codec[5];
    int linear, coding;
    int64_t step, zero, *levels, largest, low, high, last; /* largest: index of the grid */
    FILE *numbers;
    Span *spans;
    size_t span_count;
} Track;

static Track tracks[TRACKS];
static const char *folder;
static int outcome;

static void stop(int code, const char *why, ...) {
    va_list rest;
    va_start(rest, why);
    vfprintf(stderr, why, rest);
    va_end(rest);
    fputc('\n', stderr);
    exit(code);
}

static void *room_for(void *old, size_t count, size_t size) {
    void *room = count ? realloc(old, count * size) : old;
    if (count && !room) stop(ERROR, "out of memory");
    return room;
}

/* -- integers (2) -- */

static uint64_t number(const uint8_t *at, int size) {
    uint64_t value = 0;
    while (size--) value = value << 8 | at[size];
    return value;
}

static uint32_t crc32(uint32_t crc, const uint8_t *at, size_t size) {
    crc = ~crc;
    while (size--) {
        crc ^= *at++;
        for (int bit = 0; bit < 8; bit++) crc = crc >> 1 ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return ~crc;
}

static const uint8_t *take(Bytes *in, size_t size) {
    const uint8_t *at = in->at;
    if ((size_t)(in->end - at) < size) stop(NONCONFORMING, "bytes are missing");
    in->at += size;
    return at;
}

static int64_t varint(Bytes *in) {
    uint64_t value = 0;
    for (int place = 0; place < 8; place++) {
        uint8_t byte = *take(in, 1);
        value |= (uint64_t)(byte & 127) << 7 * place;
        if (byte < 128) {
            if (place && !byte) stop(NONCONFORMING, "a varint is not minimal [CNV-002]");
            if (value >> 53) break;
            return (int64_t)value;
        }
    }
    stop(NONCONFORMING, "a varint of 2^53 or more [CNV-002]");
    return 0;
}

static int64_t svarint(Bytes *in) {
    int64_t value = varint(in);
    return value & 1 ? -(value + 1) / 2 : value / 2;
}

static int64_t rdiv(int64_t n, int64_t d) {
    int64_t top = 2 * n + d, bottom = 2 * d, quotient = top / bottom;
    return quotient - (top % bottom < 0); /* C truncates, the format rounds down */
}

/* -- descriptions (6.1 to 6.3) -- */

typedef struct { int type; Bytes value; } Tlv;

static Tlv tlv(Bytes *in, int last) { /* the next one, of a type above `last` */
    int64_t type = varint(in), size = varint(in);
    if (type <= last || type > 65535) stop(NONCONFORMING, "the type of a TLV [TLV-001]");
    const uint8_t *at = take(in, (size_t)size);
    return (Tlv){(int)type, {at, at + size}};
}

static void head(Bytes in, FILE *json, uint64_t file_id) {
    const uint8_t *at = take(&in, 3), *uuid = NULL, *epoch = NULL;
    if (at[0] != 1) stop(UNSUPPORTED, "another version [VER-001]");
    if (at[2] != 1) stop(UNSUPPORTED, "level %d [HED-004]", at[2]);
    for (int last = -1; in.at < in.end;) {
        Tlv one = tlv(&in, last);
        last = one.type;
        if (last & 1) stop(UNSUPPORTED, "a critical TLV in HEAD [TLV-003]");
        if ((last == 2 || last == 4) && one.value.end - one.value.at != 16)
            stop(NONCONFORMING, "the size of a TLV in HEAD [HED-002]");
        if (last == 2) uuid = one.value.at;
        if (last == 4) epoch = one.value.at;
    }
    fprintf(json, "{\"head\": {\"major\": 1, \"minor\": %d, \"level\": 1, "
            "\"file_id\": \"0x%016" PRIx64 "\", \"uuid\": \"", at[1], file_id);
    for (int i = 0; i < 16 && uuid; i++) fprintf(json, "%02x", uuid[i]);
    if (!uuid)
        fprintf(json, "%012" PRIx64 "8%03x8%x00000000000000", file_id >> 16,
                (unsigned)(file_id >> 4 & 0xFFF), (unsigned)(file_id & 15));
    if (epoch)
        fprintf(json, "\", \"epoch_ns\": \"%" PRId64 "\", \"epoch_uncertainty_ns\": \"%" PRIu64
                "\"}", (int64_t)number(epoch, 8), number(epoch + 8, 8));
    else
        fputs("\", \"epoch_ns\": null, \"epoch_uncertainty_ns\": null}", json);
}

static void deadband_levels(Track *track, int64_t kn, int64_t kd) { /* 9.5 */
    int64_t y = 0, step = track->step;
    for (track->largest = 0;; track->largest++) {
        track->levels = room_for(track->levels, (size_t)track->largest + 1, sizeof y);
        track->levels[track->largest] = y;
        if (kn >= kd) return;
        int64_t top = y * kd / (kd - kn);
        if (top < y + step) top = y + step;
        if (top >= BOUND) return;
        int64_t c = top + 1, tolerance = kn * c / kd;
        y = c + (tolerance < step ? step : tolerance);
    }
}

static void grid(Track *track, Bytes *in) { /* 9.5 */
    int deadband = *take(in, 1);
    track->step = varint(in);
    track->zero = svarint(in);
    track->levels = NULL;
    int fits = deadband < 2 && track->step <= BOUND && (deadband || track->step > 0) &&
               track->zero >= INT32_MIN && track->zero <= INT32_MAX;
    int64_t kn = fits && deadband ? varint(in) : 0, kd = fits && deadband ? varint(in) : 1;
    if (deadband) fits = fits && kn > 0 && kd > 0 && kn < 65536 && kd < 65536 && kd <= 1024 * kn;
    if (!fits) stop(NONCONFORMING, "a grid [LPC-002]");
    if (deadband) deadband_levels(track, kn, kd);
    else track->largest = BOUND / track->step;
}

static void set_up(Track *track, const uint8_t *codec, Bytes in) {
    memcpy(track->codec, codec, 4);
    track->known = !memcmp(codec, "KNOT", 4);
    if (!track->known) return;
    track->linear = *take(&in, 1);
    track->coding = *take(&in, 1);
    if (track->linear > 1 || track->coding > 1) stop(NONCONFORMING, "parameters of KNOT [KNT-001]");
    grid(track, &in);
    if (in.at < in.end) stop(NONCONFORMING, "codec parameters are too long [COD-002]");
}

/* -- DEFLATE (RFC 1951): what TRAK may be packed as -- */

typedef struct { const uint8_t *at, *end; uint32_t hold; int held; } Bits;
typedef struct { uint16_t count[16], symbol[288]; } Code;

static unsigned bits(Bits *in, int size) { /* at most 16 */
    while (in->held < size) {
        if (in->at >= in->end) stop(NONCONFORMING, "a DEFLATE stream that is cut [TRK-020]");
        in->hold |= (uint32_t)*in->at++ << in->held;
        in->held += 8;
    }
    unsigned value = in->hold & ((1u << size) - 1);
    in->hold >>= size;
    in->held -= size;
    return value;
}

static Code code_of(const uint8_t *lengths, int size) {
    Code code = {{0}, {0}};
    int left = 1, start[16] = {0};
    for (int i = 0; i < size; i++) code.count[lengths[i]]++;
    code.count[0] = 0;
    for (int n = 1; n < 16; n++)
        if ((left = 2 * left - code.count[n]) < 0) stop(NONCONFORMING, "no code [TRK-020]");
    for (int n = 1; n < 15; n++) start[n + 1] = start[n] + code.count[n];
    for (int i = 0; i < size; i++)
        if (lengths[i]) code.symbol[start[lengths[i]]++] = (uint16_t)i;
    return code;
}

static int symbol(Bits *in, const Code *code) {
    int word = 0, first = 0, index = 0;
    for (int n = 1; n < 16; n++) {
        word |= (int)bits(in, 1);
        if (word - first < code->count[n]) return code->symbol[index + word - first];
        index += code->count[n];
        first = (first + code->count[n]) << 1;
        word <<= 1;
    }
    stop(NONCONFORMING, "no code word [TRK-020]");
    return 0;
}

static void codes(Bits *in, int fixed, Code *literal, Code *distance) {
    static const uint8_t order[] = {16, 17, 18, 0, 8,  7, 9,  6, 10, 5,
                                    11, 4,  12, 3, 13, 2, 14, 1, 15};
    uint8_t lengths[320] = {0};
    int literals = 288, distances = 30;
    if (fixed) {
        for (int i = 0; i < 318; i++)
            lengths[i] = i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : i < 288 ? 8 : 5;
    } else {
        literals = (int)bits(in, 5) + 257;
        distances = (int)bits(in, 5) + 1;
        int count = (int)bits(in, 4) + 4;
        if (literals > 286 || distances > 30) stop(NONCONFORMING, "too many symbols [TRK-020]");
        for (int i = 0; i < count; i++) lengths[order[i]] = (uint8_t)bits(in, 3);
        Code of_lengths = code_of(lengths, 19);
        memset(lengths, 0, sizeof lengths);
        for (int i = 0; i < literals + distances;) {
            int one = symbol(in, &of_lengths), times = 1;
            if (one == 16 && !i) stop(NONCONFORMING, "nothing to repeat [TRK-020]");
            if (one > 15) times = one == 18 ? 11 + (int)bits(in, 7) : 3 + (int)bits(in, one - 14);
            if (i + times > literals + distances) stop(NONCONFORMING, "too many lengths [TRK-020]");
            one = one < 16 ? one : one == 16 ? lengths[i - 1] : 0;
            while (times--) lengths[i++] = (uint8_t)one;
        }
    }
    *literal = code_of(lengths, literals);
    *distance = code_of(lengths + literals, distances);
}

static void inflate(Bits in, uint8_t *out, size_t size) { /* to exactly `size` bytes */
    size_t filled = 0;
    for (unsigned last = 0; !last;) {
        last = bits(&in, 1);
        unsigned kind = bits(&in, 2);
        if (kind == 3) stop(NONCONFORMING, "no kind of block [TRK-020]");
        if (!kind) {
            bits(&in, in.held & 7);
            size_t left = bits(&in, 16);
            if ((bits(&in, 16) ^ left) != 0xFFFF || left > size - filled)
                stop(NONCONFORMING, "a stored block [TRK-020]");
            while (left--) out[filled++] = (uint8_t)bits(&in, 8);
            continue;
        }
        Code literal, distance;
        codes(&in, kind == 1, &literal, &distance);
        for (int one; (one = symbol(&in, &literal)) != 256;) {
            size_t length = 1, back = 0;
            if (one > 256 && one < 286) {
                int n = one - 257, more = n < 8 || n == 28 ? 0 : (n - 4) / 4;
                length = n < 8 ? (size_t)n + 3 : n == 28 ? 258 : ((size_t)(4 + n % 4) << more) + 3;
                length += bits(&in, more);
                n = symbol(&in, &distance);
                more = n < 4 ? 0 : (n - 2) / 2;
                back = (n < 4 ? (size_t)n + 1 : ((size_t)(2 + n % 2) << more) + 1) + bits(&in, more);
            }
            if (length > size - filled || back > filled || one > 285)
                stop(NONCONFORMING, "a repetition that is too long [TRK-020]");
            if (!back) out[filled++] = (uint8_t)one;
            else for (; length--; filled++) out[filled] = out[filled - back];
        }
    }
    if (filled < size || in.at < in.end) stop(NONCONFORMING, "another size [TRK-020]");
}

/* -- tracks (6.3) -- */

static void describe_one(Bytes *in, Track *track) {
    const uint8_t *at = take(in, 6);
    int critical = 0, has_setup = 0;
    track->described = 1;
    track->kind = at[0] & 15;
    track->format = at[0] >> 4;
    memcpy(track->codec, at + 1, 4);
    track->components = at[5];
    for (int i = 0; i < 2; i++) {
        int64_t part = varint(in);
        if (part < 1 || part > UINT32_MAX) stop(NONCONFORMING, "a rate [TRK-002]");
        track->rate[i] = (uint32_t)part;
    }
    track->low = svarint(in);
    track->high = svarint(in);
    varint(in); /* first_channel */
    varint(in); /* linked */
    for (int left = *take(in, 1), last = -1; left > 0; left--) {
        Tlv one = tlv(in, last);
        last = one.type;
        if (last == 1) set_up(track, at + 1, one.value);
        has_setup |= last == 1;
        if (last == 5 && one.value.end - one.value.at != 2 * (track->components - 1))
            stop(NONCONFORMING, "how many channel numbers [TLV-004]");
        critical |= last & 1 && last > 5;
    }
    if (critical || track->kind > 2 || track->format || !has_setup) track->known = 0;
    if (!track->known) outcome = UNSUPPORTED; /* TRK-011, TLV-003 */
}

static void describe(Bytes in) {
    int64_t id = varint(&in), size = varint(&in);
    uint8_t *plain = NULL;
    if (id < TRACKS && tracks[id].described) return; /* a copy (TRK-003) */
    if (size >= PAYLOAD) stop(NONCONFORMING, "tracks that are too long [TRK-020]");
    if (size) {
        plain = room_for(NULL, (size_t)size, 1);
        inflate((Bits){in.at, in.end, 0, 0}, plain, (size_t)size);
        in = (Bytes){plain, plain + size};
    }
    for (int components = 0; !components || in.at < in.end; id++) {
        if (id >= TRACKS) stop(NONCONFORMING, "too many tracks [TRK-003]");
        describe_one(&in, tracks + id);
        if (!tracks[id].components || (components += tracks[id].components) > COMPONENTS)
            stop(NONCONFORMING, "how many components [TRK-002]");
    }
    free(plain);
}

/* -- entropy coding (9.4) -- */

typedef struct { Bytes in; int64_t x, next, raw; } Coder; /* of one state */

typedef struct { int64_t p, n; } Model;

static int64_t byte_at(const Coder *c, int64_t at) {
    return at >= 0 && at < c->in.end - c->in.at ? c->in.at[at] : 0;
}

static int64_t word(Coder *c) {
    c->next += 2;
    return 256 * byte_at(c, c->next - 2) + byte_at(c, c->next - 1);
}

static void check(const Coder *c) {
    if (c->next + (c->raw + 7) / 8 > c->in.end - c->in.at)
        stop(NONCONFORMING, "the coded bytes end too early [RNG-001]");
}

static int64_t raw_bits(Coder *c, int count) {
    int64_t value = 0, size = c->in.end - c->in.at;
    for (int i = 0; i < count; i++, c->raw++)
        value |= (byte_at(c, size - 1 - c->raw / 8) >> c->raw % 8 & 1) << i;
    return value;
}

static int coded(Coder *c, int64_t zeros) { /* 1 or 0, with the ends zeros and 4096 */
    int64_t slot = c->x % 4096;
    int bit = slot >= zeros;
    c->x = bit ? (4096 - zeros) * (c->x / 4096) + slot - zeros : zeros * (c->x / 4096) + slot;
    if (c->x < 65536) c->x = c->x * 65536 + word(c);
    return bit;
}

static void learn(Model *m, int bit, int limit) {
    int t = 1;
    while (t < limit && (m->n + 2) >> (t + 1)) t++;
    m->p += bit ? (65535 - m->p) >> t : -(m->p >> t);
    m->n++;
}

static int flag(Coder *c, Model *m) { /* of one model */
    int bit = coded(c, 4096 - m->p / 16);
    learn(m, bit, 7);
    return bit;
}

static int bits_of(int64_t x, int most) {
    int bits = 0;
    while (bits < most && x >> bits) bits++;
    return bits;
}

static void by_bits(Coder *c, int64_t count, int with_signs, int64_t *out) {
    enum { KINDS = 36 }; /* k is below */
    static Model a_[9][KINDS], b_[12][KINDS], c_[KINDS], d_[3];
    int64_t a = 0, b = 0, s = 0, d = 0;
    const Model even = {32768, 0}, rare = {8192, 2};
    for (int k = 0; k < KINDS; k++) {
        for (int i = 0; i < 9; i++) a_[i][k] = k < i - 2 ? rare : even;
        for (int j = 0; j < 12; j++) b_[j][k] = k < j - 5 ? rare : even;
        c_[k] = even;
    }
    for (int i = 0; i < 3; i++) d_[i] = even;
    for (int64_t t = 0; t < count; t++) {
        int64_t g = 2 * a + b;
        Model *near = a_[g < 3 ? g : 1 + bits_of(g, 7)], *loud = b_[bits_of(s, 11)];
        int bit = 0, k = 0;
        for (; k < KINDS && !bit; k++) {
            bit = coded(c, 4096 - (near[k].p + loud[k].p) / 32);
            learn(near + k, bit, 5);
            learn(loud + k, bit, 7);
        }
        if (!bit) {
            check(c);
            stop(NONCONFORMING, "k is 36 [RNG-003]");
        }
        int64_t u = --k;
        if (k > 2) {
            u = (int64_t)(2 + flag(c, c_ + k)) << (k - 3);
            u += 1 + raw_bits(c, k - 3);
            if (u >> 34) stop(NONCONFORMING, "2^34 or more [RNG-003]");
        }
        if (with_signs && u) d = 1 + flag(c, d_ + d);
        check(c);
        out[t] = u && d == 2 ? -u : u;
        b = a;
        a = u;
        int64_t rise = 64 * u - s;
        s += rise >= 0 ? rise / 8 : -((7 - rise) / 8);
    }
}

static void coder_end(Coder *c) {
    int64_t back = (c->raw + 7) / 8;
    if (c->x != 65536 || c->next + back != c->in.end - c->in.at ||
        raw_bits(c, (int)(8 * back - c->raw)))
        stop(NONCONFORMING, "the coded bytes end otherwise [RNG-001]");
}

/* -- packets (6.4, 9.1, 9.6) -- */

/* Gaps, and then the differences of each component. */
static void coded_rows(Bytes in, int64_t gaps, int64_t differences, int64_t *out) {
    Coder c = {in, 0, 0, 0};
    c.x = word(&c) << 16;
    c.x |= word(&c);
    check(&c);
    by_bits(&c, gaps, 0, out);
    by_bits(&c, differences, 1, out + gaps);
    coder_end(&c);
}

static int64_t count_of(const Track *track, int64_t index) {
    int64_t size = index < 0 ? -index : index;
    if (size > track->largest) stop(NONCONFORMING, "an index is not on the grid [LPC-003]");
    if (!track->levels) return track->zero + index * track->step;
    return track->zero + (index < 0 ? -track->levels[size] : track->levels[size]);
}

static void knots(const Track *track, Bytes in, int64_t span, int64_t *counts) {
    int width = track->components;
    int64_t tick = 0, left = 0, further = 0, *rows = NULL, index[COMPONENTS], count[COMPONENTS];
    for (int c = 0; c < width; c++) count[c] = count_of(track, index[c] = svarint(&in));
    if (track->coding && in.at < in.end) {
        left = varint(&in);
        if (left < 1 || left >= span) stop(NONCONFORMING, "how many knots [KTE-004]");
        further = left;
        rows = room_for(NULL, (size_t)(further * (width + 1)), sizeof *rows);
        coded_rows(in, further - track->linear, further * width, rows);
    }
    while (track->coding ? left-- > 0 : in.at < in.end) {
        int64_t from = tick, step;
        if (!track->coding) step = varint(&in);
        else if (track->linear && !left) step = span - 1 - tick;
        else step = 1 + rows[further - 1 - left];
        tick += step;
        if (step < 1 || tick >= span - (track->coding ? left : 0))
            stop(NONCONFORMING, "a knot's tick [KNT-003, KTE-004]");
        for (int c = 0; c < width; c++) {
            int64_t before = count[c];
            int64_t at = (c + 2) * further - track->linear - 1 - left;
            index[c] += track->coding ? rows[at] : svarint(&in);
            count[c] = count_of(track, index[c]);
            int64_t rise = track->linear ? count[c] - before : 0;
            for (int64_t t = from; t < tick; t++)
                counts[t * width + c] = before + rdiv(rise * (t - from), step);
        }
    }
    if (track->linear && tick && tick < span - 1)
        stop(NONCONFORMING, "the last knot of a line [KNT-003]");
    for (; tick < span; tick++)
        for (int c = 0; c < width; c++) counts[tick * width + c] = count[c];
    free(rows);
}

static void deliver(Track *track, unsigned id, int64_t start, int64_t span, int64_t *counts) {
    size_t count = track->span_count;
    if (start < track->last) stop(NONCONFORMING, "packets overlap [DAT-006]");
    track->last = start + span;
    if (count && track->spans[count - 1].stop == start)
        track->spans[count - 1].stop = start + span;
    else if (span) {
        track->spans = room_for(track->spans, count + 1, sizeof(Span));
        track->spans[track->span_count++] = (Span){start, start + span};
    }
    char path[4096];
    snprintf(path, sizeof path, "%s/track-%u.raw", folder, id);
    FILE *out = fopen(path, "ab");
    if (!out) stop(ERROR, "%s cannot be written", path);
    for (int64_t i = 0; i < span * track->components; i++) {
        int64_t low = counts[i] < track->low ? track->low : counts[i]; /* DEC-001 */
        uint64_t word = (uint64_t)(low > track->high ? track->high : low);
        for (int byte = 0; byte < 8; byte++) fputc((int)(word >> 8 * byte & 255), out);
    }
    if (fclose(out)) stop(ERROR, "%s cannot be written", path);
}

static uint32_t crc_of_number(uint32_t crc, uint64_t value) { /* of a u64 */
    uint8_t bytes[8];
    for (int i = 0; i < 8; i++) bytes[i] = (uint8_t)(value >> 8 * i);
    return crc32(crc, bytes, 8);
}

static void cluster(Bytes in, uint32_t seed) { /* 6.4; `seed`: where a cluster CRC goes on from */
    typedef struct { int64_t track, size, start, span; uint64_t crc; } Entry;
    const uint8_t *begin = in.at;
    int64_t count = varint(&in), samples = 0, least[4];
    if (count < 1 || count > PACKETS) stop(NONCONFORMING, "how many packets [DAT-001]");
    const uint8_t *at = take(&in, 2);
    int widths[4] = {at[0] & 15, at[0] >> 4, at[1] & 15, at[1] >> 4};
    for (int i = 0; i < 4; i++)
        if (widths[i] > 6) stop(NONCONFORMING, "the bytes of a field [DAT-001]");
    for (int i = 0; i < 4; i++) least[i] = varint(&in);
    Entry *entries = room_for(NULL, (size_t)count, sizeof(Entry));
    for (int64_t i = 0; i < count; i++) {
        Entry *e = entries + i;
        int64_t *fields[4] = {&e->track, &e->size, &e->start, &e->span};
        for (int f = 0; f < 4; f++)
            *fields[f] = least[f] + (int64_t)number(take(&in, (size_t)widths[f]), widths[f]);
        e->crc = number(take(&in, 4), 4);
        if (e->span < 1 || e->span > SPAN || e->start + e->span > (int64_t)1 << 48)
            stop(NONCONFORMING, "a span [DAT-003]");
        if (e->track >= TRACKS || !tracks[e->track].described)
            stop(NONCONFORMING, "a packet of a track that is not described [DAT-008]");
        samples += e->span * tracks[e->track].components;
        if (samples > CLUSTER) stop(NONCONFORMING, "too many samples [DAT-009]");
    }
    uint32_t found = crc32(seed, begin, (size_t)(in.at - begin));
    if (found != number(take(&in, 4), 4)) stop(NONCONFORMING, "a table's CRC [DAT-011]");
    for (int64_t i = 0; i < count; i++) {
        Entry *e = entries + i;
        Track *track = tracks + e->track;
        Bytes packet = {take(&in, (size_t)e->size), in.at};
        uint32_t crc = crc_of_number(seed, (uint64_t)count);
        crc = crc_of_number(crc, (uint64_t)e->track);
        crc = crc_of_number(crc, (uint64_t)e->size);
        crc = crc_of_number(crc, (uint64_t)e->start);
        crc = crc_of_number(crc, (uint64_t)e->span);
        if (crc32(crc, packet.at, (size_t)e->size) != e->crc)
            stop(NONCONFORMING, "a packet's CRC [DAT-004]");
        if (!track->known) continue;
        packet.end = packet.at + e->size;
        int64_t *counts = room_for(NULL, (size_t)(e->span * track->components), sizeof *counts);
        knots(track, packet, e->span, counts);
        deliver(track, (unsigned)e->track, e->start, e->span, counts);
        free(counts);
    }
    if (in.at < in.end) stop(NONCONFORMING, "bytes behind the last packet [DAT-005]");
    free(entries);
}

/* -- the file (5) -- */

static int known_type(const uint8_t *type) {
    static const char *types = "HEADTRAKDATAiNDXfOOTmETaaTTcdGSTcLOkcMAp";
    for (const char *known = types; *known; known += 4)
        if (!memcmp(known, type, 4)) return 1;
    return 0;
}

static void walk(Bytes in, FILE *json) {
    static const uint8_t signature[] = {0x8F, 'H', 'A', 'P', '\r', '\n', 0x1A, '\n'};
    static const uint8_t sync[] = {0xF9, 0x48, 0x8B, 0x1C};
    uint64_t file_id = 0;
    uint32_t sequence = 0;
    int closed = 0;
    if (in.end - in.at < 8 || memcmp(in.at, signature, 8)) stop(NONCONFORMING, "no signature");
    for (in.at += 8; in.end - in.at >= HEADER; sequence++) {
        const uint8_t *h = in.at;
        size_t size = (size_t)number(h + 20, 4);
        uint32_t seed = crc32(0, h + 8, 8); /* a file CRC goes on from here */
        if (memcmp(h, sync, 4) || crc32(0, h, 28) != number(h + 28, 4)) break;
        if ((size_t)(in.end - h - HEADER) < size) break;
        if (crc32(seed, h + HEADER, size) != number(h + 24, 4)) break;
        if (number(h + 16, 4) != sequence || (sequence && number(h + 8, 8) != file_id)) break;
        file_id = number(h + 8, 8);
        in.at += HEADER + size;
        closed = !memcmp(h + 4, "fOOT", 4);
        Bytes payload = {h + HEADER, h + HEADER + size};
        if (!known_type(h + 4) && !(h[4] & 32)) stop(UNSUPPORTED, "unknown critical chunk [CHK-009]");
        if (!sequence && memcmp(h + 4, "HEAD", 4)) stop(NONCONFORMING, "no HEAD [HED-001]");
        if (!sequence) head(payload, json, file_id);
        if (!memcmp(h + 4, "TRAK", 4)) describe(payload);
        if (!memcmp(h + 4, "DATA", 4)) cluster(payload, crc_of_number(seed, sequence));
    }
    if (!sequence) stop(NONCONFORMING, "no chunk");
    if (in.at < in.end || !closed) outcome = DAMAGED;
}

static void tell(FILE *json) {
    static const char *kinds[] = {"full", "lf", "hf"};
    const char *comma = "";
    fputs(", \"tracks\": [", json);
    for (unsigned id = 0; id < TRACKS; id++) {
        Track *track = tracks + id;
        if (!track->described || !track->known) continue;
        fprintf(json, "%s\n {\"track\": %u, \"kind\": \"%s\", \"codec\": \"%s\", ", comma, id,
                kinds[track->kind], track->codec);
        fprintf(json, "\"number_format\": \"counts\", \"component_count\": %d, ", track->components);
        fprintf(json, "\"rate\": [%" PRIu32 ", %" PRIu32 "], \"spans\": [", track->rate[0],
                track->rate[1]);
        for (size_t i = 0; i < track->span_count; i++)
            fprintf(json, "%s[%" PRId64 ", %" PRId64 "]", i ? ", " : "", track->spans[i].start,
                    track->spans[i].stop);
        fprintf(json, "], \"numbers\": \"track-%u.raw\"}", id);
        if (!track->span_count) deliver(track, id, 0, 0, NULL);
        comma = ",";
    }
    fputs("]}\n", json);
}

static int decode(const char *source) {
    char path[4096];
    FILE *in = fopen(source, "rb"), *json;
    uint8_t *data = NULL;
    size_t size = 0, got;
    if (!in) stop(ERROR, "%s cannot be read", source);
    do {
        data = room_for(data, size + 65536, 1);
        size += got = fread(data + size, 1, 65536, in);
    } while (got);
    fclose(in);
    snprintf(path, sizeof path, "%s/decode.json", folder);
    if (!(json = fopen(path, "wb"))) stop(ERROR, "%s cannot be written", path);
    walk((Bytes){data, data + size}, json);
    tell(json);
    if (fclose(json)) stop(ERROR, "%s cannot be written", path);
    free(data);
    return outcome;
}

int main(int count, char **given) {
    if (count == 2 && !strcmp(given[1], "capabilities")) {
        puts("{\"name\": \"knot.c\", \"version\": \"1.0\", \"format\": \"1.0\", \"level\": 1,\n"
             " \"verbs\": [\"decode\"], \"codecs\": [\"KNOT\"], \"parts\": [\"tracks\"],\n"
             " \"sets\": [\"valid\", \"uncommon\"]}");
        return 0;
    }
    if (count != 4 || strcmp(given[1], "decode")) stop(ERROR, "knot capabilities | decode IN OUT");
    folder = given[3];
    return decode(given[2]);
}
