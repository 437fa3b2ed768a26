#include "gof_board.h"

uint32_t gof_gray(uint32_t count) { return count ^ (count >> 1); }

uint32_t gof_pattern(uint32_t count, uint32_t phase) {
    count &= GOF_COUNT_MASK;
    phase %= GOF_TICKS_PER_PERIOD;
    uint32_t strip = phase / GOF_TICKS_PER_SLOT;
    uint32_t late = phase >= GOF_DISAMBIGUATION_TICK ? 1u : 0u;
    return (1u << strip) | (gof_gray(count) << GOF_GRAY_FIRST) | (((count + late) & 1u) << GOF_DISAMBIGUATION);
}

void gof_board_init(gof_board *board) {
    board->state = GOF_STOPPED;
    board->count = 0u;
    board->phase = 0u;
    board->periods = 0u;
    board->test_mask = 0u;
}

void gof_board_arm(gof_board *board, uint32_t count) {
    gof_board_init(board);
    board->count = count & GOF_COUNT_MASK;
    board->state = GOF_ARMED;
}

bool gof_board_start(gof_board *board) {
    if (board->state != GOF_STOPPED && board->state != GOF_ARMED) {
        return false;
    }
    if (board->state == GOF_STOPPED) {
        gof_board_init(board);
    }
    board->state = GOF_RUNNING;
    return true;
}

void gof_board_stop(gof_board *board) { board->state = GOF_STOPPED; }

bool gof_board_test(gof_board *board, gof_test test, uint32_t output) {
    switch (test) {
    case GOF_TEST_ALL_OFF:
        board->test_mask = 0u;
        break;
    case GOF_TEST_ALL_ON:
        board->test_mask = GOF_ALL_OUTPUTS;
        break;
    case GOF_TEST_ONE:
        if (output >= GOF_OUTPUTS) {
            return false;
        }
        board->test_mask = 1u << output;
        break;
    default:
        return false;
    }
    board->state = GOF_TEST;
    return true;
}

uint32_t gof_board_lit(const gof_board *board) {
    switch (board->state) {
    case GOF_ARMED:
    case GOF_RUNNING:
        return gof_pattern(board->count, board->phase);
    case GOF_TEST:
        return board->test_mask;
    case GOF_STOPPED:
    default:
        return 0u;
    }
}

void gof_board_step(gof_board *board) {
    if (board->state != GOF_RUNNING) {
        return;
    }
    if (++board->phase == GOF_TICKS_PER_PERIOD) {
        board->phase = 0u;
        board->count = (board->count + 1u) & GOF_COUNT_MASK;
        board->periods++;
    }
}
