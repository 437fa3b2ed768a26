/* Serial framing: COBS(payload + CRC-16) followed by one zero byte.
 *
 * COBS removes zeros from the body, so a zero is always the end of a frame: after noise or a dropped byte the receiver
 * is in step again at the next zero. CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF), little endian.
 */
#ifndef GOF_FRAME_H
#define GOF_FRAME_H

#include <stddef.h>
#include <stdint.h>

#define GOF_PAYLOAD_MAX 64u
#define GOF_FRAME_MAX (GOF_PAYLOAD_MAX + 2u + 1u + 1u) /* CRC, one COBS code (body < 254), end */

typedef struct {
    uint8_t buffer[GOF_FRAME_MAX];
    size_t length;
    uint8_t overflow; /* the frame is too long; wait for its end and drop it */
    uint32_t bad_frames;
} gof_reader;

uint16_t gof_crc16(const uint8_t *data, size_t length);

/* Write the frame of a payload; returns its length, 0 when the payload is longer than GOF_PAYLOAD_MAX. */
size_t gof_frame_encode(const uint8_t *payload, size_t length, uint8_t frame[GOF_FRAME_MAX]);

void gof_reader_init(gof_reader *reader);

/* Feed one byte; returns the payload length when it completes a good frame (payload: GOF_FRAME_MAX bytes), else 0. */
size_t gof_reader_push(gof_reader *reader, uint8_t byte, uint8_t *payload);

#endif
