/* The board as a device: commands in, replies out, one interrupt per tick. */
#ifndef GOF_APP_H
#define GOF_APP_H

#include "gof_board.h"
#include "gof_frame.h"
#include "gof_port.h"

#define GOF_PROTOCOL_VERSION 1u
#define GOF_FIRMWARE_VERSION "0.1.0"

enum { /* request type; a reply has the same type with the top bit set, then a status byte */
    GOF_IDENTIFY = 1,
    GOF_STATUS = 2,
    GOF_SET_TICK = 3,
    GOF_ARM = 4,
    GOF_START = 5,
    GOF_STOP = 6,
    GOF_SHOW_TEST = 7,
    GOF_SELF_TEST = 8
};

enum { GOF_OK = 0, GOF_UNKNOWN = 1, GOF_BAD_ARGUMENT = 2, GOF_WRONG_STATE = 3, GOF_WRONG_VERSION = 4 };

typedef struct {
    uint32_t ticks;       /* interrupts seen since start */
    int32_t earliest_ns;  /* against the ideal time of the tick */
    int32_t latest_ns;
    uint64_t total_abs_ns;
} gof_jitter;

typedef struct {
    gof_board board;
    gof_reader reader;
    gof_jitter jitter;
    uint32_t tick_us;
    uint32_t wired; /* logical outputs that have a pin */
    uint32_t next_low, next_high; /* levels of the coming tick, ready before the interrupt */
} gof_app;

void gof_app_init(gof_app *app);

/* The tick interrupt. late_ns: how late (+) or early (-) against the ideal time of this tick. Integer arithmetic only;
 * writes the levels prepared by the previous tick first, so their delay does not depend on the pattern. */
void gof_app_tick(gof_app *app, int32_t late_ns);

/* A reply begins with a zero, as a request does: it ends whatever text the boot loader left on the line. */
#define GOF_REPLY_MAX (1u + GOF_FRAME_MAX)

/* Feed one received byte; returns the length of a reply in `reply`, 0 when there is none. */
size_t gof_app_receive(gof_app *app, uint8_t byte, uint8_t reply[GOF_REPLY_MAX]);

/* Register levels of lit outputs, polarity applied. */
void gof_app_levels(uint32_t lit, uint32_t *low, uint32_t *high);

#endif
