#include "gof_frame.h"

uint16_t gof_crc16(const uint8_t *data, size_t length) {
    uint16_t crc = 0xFFFFu;
    for (size_t i = 0; i < length; i++) {
        crc = (uint16_t)(crc ^ (uint16_t)((uint16_t)data[i] << 8));
        for (int bit = 0; bit < 8; bit++) {
            crc = (uint16_t)((crc & 0x8000u) ? ((uint32_t)crc << 1) ^ 0x1021u : (uint32_t)crc << 1);
        }
    }
    return crc;
}

size_t gof_frame_encode(const uint8_t *payload, size_t length, uint8_t frame[GOF_FRAME_MAX]) {
    if (length > GOF_PAYLOAD_MAX) {
        return 0;
    }
    uint16_t crc = gof_crc16(payload, length);
    size_t code_at = 0;
    size_t out = 1;
    for (size_t i = 0; i < length + 2u; i++) {
        uint8_t byte = i < length ? payload[i] : (uint8_t)(i == length ? crc & 0xFFu : crc >> 8);
        if (byte == 0u) {
            frame[code_at] = (uint8_t)(out - code_at);
            code_at = out++;
        } else {
            frame[out++] = byte;
        }
    }
    frame[code_at] = (uint8_t)(out - code_at);
    frame[out++] = 0u;
    return out;
}

void gof_reader_init(gof_reader *reader) {
    reader->length = 0;
    reader->overflow = 0;
    reader->bad_frames = 0;
}

/* COBS-decode the buffer; returns the decoded length, or 0 when a code points beyond the frame. */
static size_t decode(const gof_reader *reader, uint8_t *payload) {
    size_t in = 0;
    size_t out = 0;
    while (in < reader->length) {
        size_t code = reader->buffer[in++];
        if (code - 1u > reader->length - in) {
            return 0;
        }
        for (size_t i = 1; i < code; i++) {
            payload[out++] = reader->buffer[in++];
        }
        if (in < reader->length) {
            payload[out++] = 0u;
        }
    }
    return out;
}

size_t gof_reader_push(gof_reader *reader, uint8_t byte, uint8_t *payload) {
    if (byte != 0u) {
        if (reader->length < sizeof reader->buffer) {
            reader->buffer[reader->length++] = byte;
        } else {
            reader->overflow = 1;
        }
        return 0;
    }
    size_t length = reader->overflow ? 0 : decode(reader, payload);
    int empty = reader->length == 0;
    reader->length = 0;
    reader->overflow = 0;
    if (empty) {
        return 0; /* repeated ends are how a sender clears the line */
    }
    if (length < 3u || length - 2u > GOF_PAYLOAD_MAX ||
        gof_crc16(payload, length - 2u) != (uint16_t)(payload[length - 2u] | (uint16_t)(payload[length - 1u] << 8))) {
        reader->bad_frames++;
        return 0;
    }
    return length - 2u;
}
