/* What a board must provide. The ESP32 layer and the host's fake registers implement the same five functions. */
#ifndef GOF_PORT_H
#define GOF_PORT_H

#include <stddef.h>
#include <stdint.h>

/* Drive all outputs: the two words are the complete levels of the pins in the map (bit = GPIO 0..31, 32..63). */
void gof_port_write(uint32_t low, uint32_t high);

/* Read back the levels at the pins. */
void gof_port_read(uint32_t *low, uint32_t *high);

/* (Re)start the periodic tick interrupt, first tick one tick from now; or stop it. */
void gof_port_timer_start(uint32_t tick_us);
void gof_port_timer_stop(void);

/* Keep the tick interrupt out while the main loop changes shared state. */
void gof_port_lock(void);
void gof_port_unlock(void);

/* GPIO number of each logical output, -1 when the board does not wire it; NULL-free, GOF_OUTPUTS entries. */
extern const int8_t gof_port_pins[];
/* Logical outputs whose LED lights at a low level. */
extern const uint32_t gof_port_active_low;
extern const char gof_port_name[];

#endif
