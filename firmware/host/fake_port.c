#include "fake_port.h"

#include "gof_board.h"
#include "gof_port.h"

/* The ESP32-S3 map of esp-idf/main/pins_esp32s3.h, so that host tests exercise both register words. */
#include "../esp-idf/main/pins_esp32s3.h"

const int8_t gof_port_pins[GOF_OUTPUTS] = GOF_PINS;
#ifndef GOF_ACTIVE_LOW
#define GOF_ACTIVE_LOW 0u
#endif
const uint32_t gof_port_active_low = GOF_ACTIVE_LOW;
const char gof_port_name[] = "host";

fake_registers fake;

void fake_reset(void) { fake = (fake_registers){.bridge_a = -1, .bridge_b = -1}; }

void gof_port_write(uint32_t low, uint32_t high) {
    fake.low = low;
    fake.high = high;
    fake.writes++;
}

void gof_port_read(uint32_t *low, uint32_t *high) {
    uint64_t pins = ((uint64_t)fake.high << 32) | fake.low;
    if (fake.bridge_a >= 0 && fake.bridge_b >= 0) {
        uint64_t both = (1ull << fake.bridge_a) | (1ull << fake.bridge_b);
        pins |= (pins & both) ? both : 0u;
    }
    pins = (pins | fake.stuck_high) & ~fake.stuck_low;
    *low = (uint32_t)pins;
    *high = (uint32_t)(pins >> 32);
}

void gof_port_timer_start(uint32_t tick_us) { fake.tick_us = tick_us; }
void gof_port_timer_stop(void) { fake.tick_us = 0; }
void gof_port_lock(void) { fake.locked++; }
void gof_port_unlock(void) { fake.locked--; }
