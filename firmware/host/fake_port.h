/* Registers in memory: what the core wrote last, with wiring faults that tests can switch on. */
#ifndef FAKE_PORT_H
#define FAKE_PORT_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint32_t low, high;        /* output registers */
    uint64_t stuck_high, stuck_low; /* pins that do not follow */
    int bridge_a, bridge_b;    /* two pins wired together (either high: both high), -1 none */
    uint32_t tick_us;          /* 0: timer stopped */
    uint32_t writes;
    int locked;
} fake_registers;

extern fake_registers fake;
void fake_reset(void);

#endif
