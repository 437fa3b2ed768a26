/* The board on a pseudo-terminal: the firmware's own core and protocol, fake registers, the computer's clock as timer.
 * Prints the terminal's path, then serves until its standard input closes (so it never outlives who started it).
 * --bridge A B: outputs A and B wired together, for the self-test. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "fake_port.h"
#include "gof_app.h"

static int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

int main(int argc, char **argv) {
    fake_reset();
    if (argc == 4 && strcmp(argv[1], "--bridge") == 0) {
        fake.bridge_a = gof_port_pins[(unsigned)atoi(argv[2]) % GOF_OUTPUTS];
        fake.bridge_b = gof_port_pins[(unsigned)atoi(argv[3]) % GOF_OUTPUTS];
    }
    int terminal = posix_openpt(O_RDWR | O_NOCTTY);
    if (terminal < 0 || grantpt(terminal) || unlockpt(terminal)) {
        perror("pseudo-terminal");
        return 1;
    }
    const char *path = ptsname(terminal);
    /* Keep one client end open in raw mode: the line survives a client that closes and reopens it. */
    int client = open(path, O_RDWR | O_NOCTTY);
    struct termios raw;
    if (client < 0 || tcgetattr(client, &raw)) {
        perror(path);
        return 1;
    }
    cfmakeraw(&raw);
    tcsetattr(client, TCSANOW, &raw);
    fcntl(terminal, F_SETFL, O_NONBLOCK);
    printf("%s\n", path);
    fflush(stdout);

    gof_app app;
    gof_app_init(&app);
    int64_t next_tick = 0;
    for (;;) {
        struct pollfd wait[2] = {{.fd = terminal, .events = POLLIN}, {.fd = STDIN_FILENO, .events = POLLIN}};
        poll(wait, 2, fake.tick_us ? 1 : 50);
        char ignored[64];
        if ((wait[1].revents & (POLLIN | POLLHUP)) && read(STDIN_FILENO, ignored, sizeof ignored) <= 0) {
            return 0;
        }
        uint8_t bytes[256], reply[GOF_REPLY_MAX];
        ssize_t count = read(terminal, bytes, sizeof bytes);
        for (ssize_t i = 0; i < count; i++) {
            uint32_t was_running = fake.tick_us;
            size_t length = gof_app_receive(&app, bytes[i], reply);
            if (!was_running && fake.tick_us) {
                next_tick = now_ns() + (int64_t)fake.tick_us * 1000;
            }
            if (length && write(terminal, reply, length) < 0 && errno != EAGAIN) {
                return 1;
            }
        }
        while (fake.tick_us && now_ns() >= next_tick) {
            gof_app_tick(&app, (int32_t)(now_ns() - next_tick));
            next_tick += (int64_t)fake.tick_us * 1000;
        }
    }
}
