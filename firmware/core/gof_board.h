/* The LED board's clock: which of the 21 outputs are lit in each tick. Portable C99, no heap, no floating point.
 *
 *   tick    400 us by default; the interrupt runs once per tick
 *   slot    2 ticks: strip k is lit in slot k (k = 0..4)
 *   period  10 ticks = 5 slots: the counter advances by one
 *
 * Outputs are numbered logically: strips 0..4, Gray bits 5..19 (bit 0 first), disambiguation LED 20.
 *
 * The counter shows the number of periods in reflected Gray code, so exactly one of its LEDs changes per period and a
 * picture taken across the change reads one of two neighbouring counts. The disambiguation LED shows the lowest bit
 * of the count 6 ticks later, ((tick + 6) / 10) & 1: it turns with the third slot, is steady whenever the Gray code
 * changes, and tells which of the two counts belongs to the change. (The board in the paper's footage turns it there.) Both wrap together: the count after 2^bits - 1 is 0, again with one
 * Gray LED changing, and 2^bits is even, so the disambiguation LED goes on alternating.
 */
#ifndef GOF_BOARD_H
#define GOF_BOARD_H

#include <stdbool.h>
#include <stdint.h>

#define GOF_STRIPS 5u
#define GOF_GRAY_BITS 15u
#define GOF_OUTPUTS 21u
#define GOF_GRAY_FIRST GOF_STRIPS
#define GOF_DISAMBIGUATION (GOF_STRIPS + GOF_GRAY_BITS)
#define GOF_ALL_OUTPUTS ((1u << GOF_OUTPUTS) - 1u)
#define GOF_TICKS_PER_SLOT 2u
#define GOF_TICKS_PER_PERIOD (GOF_STRIPS * GOF_TICKS_PER_SLOT)
#define GOF_DISAMBIGUATION_TICK 4u
#define GOF_COUNT_MASK ((1u << GOF_GRAY_BITS) - 1u)
#define GOF_TICK_US_DEFAULT 400u
#define GOF_TICK_US_MIN 50u
#define GOF_TICK_US_MAX 100000u

typedef enum {
    GOF_STOPPED = 0, /* dark; the power-on state */
    GOF_ARMED = 1,   /* shows the first pattern of the preset count and waits for start */
    GOF_RUNNING = 2, /* one step per tick */
    GOF_TEST = 3     /* shows a fixed test pattern */
} gof_state;

typedef enum { GOF_TEST_ALL_OFF = 0, GOF_TEST_ALL_ON = 1, GOF_TEST_ONE = 2 } gof_test;

typedef struct {
    gof_state state;
    uint32_t count;    /* periods, 0 .. GOF_COUNT_MASK, wraps to 0 */
    uint32_t phase;    /* ticks into the period, 0 .. GOF_TICKS_PER_PERIOD - 1 */
    uint32_t periods;  /* periods since start, wraps at 2^32 (198 days at 400 us) */
    uint32_t test_mask;
} gof_board;

uint32_t gof_gray(uint32_t count);

/* Lit outputs (logical mask) at a count and phase. Inputs beyond their range are reduced modulo it. */
uint32_t gof_pattern(uint32_t count, uint32_t phase);

void gof_board_init(gof_board *board);
void gof_board_arm(gof_board *board, uint32_t count);
bool gof_board_start(gof_board *board); /* from stopped (count 0) or armed; false when running or testing */
void gof_board_stop(gof_board *board);
bool gof_board_test(gof_board *board, gof_test test, uint32_t output); /* false for an unknown test or output */

/* Lit outputs now. */
uint32_t gof_board_lit(const gof_board *board);

/* One tick later; does nothing unless running. */
void gof_board_step(gof_board *board);

#endif
