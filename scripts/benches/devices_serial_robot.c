/* The robot of `devices_serial` in C: a frame with a number comes in, one with the same number goes out.
 *
 *     robot SENSOR MOTOR
 *
 * Prints `ready`, and ends where the sensor's line does.
 */
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

static int open_line(const char *path)
{
    struct termios mode;
    int fd = open(path, O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);

    if (fd < 0 || tcgetattr(fd, &mode) != 0) {
        perror(path);
        exit(1);
    }
    cfmakeraw(&mode);
    tcsetattr(fd, TCSANOW, &mode);
    return fd;
}

int main(int count, char **words)
{
    char held[4096], frame[64];
    size_t used = 0;
    int sensor, motor;

    if (count != 3)
        return 2;
    sensor = open_line(words[1]);
    motor = open_line(words[2]);
    puts("ready");
    fflush(stdout);
    for (;;) {
        struct pollfd waits = {.fd = sensor, .events = POLLIN};
        ssize_t got;
        char *begin = held, *end;

        poll(&waits, 1, -1);
        got = read(sensor, held + used, sizeof held - used);
        if (got <= 0)
            return 0;
        used += (size_t)got;
        while ((end = memchr(begin, '\n', used - (size_t)(begin - held))) != NULL) {
            if (begin[0] == 'S' && begin[1] == ' ') {
                int size = snprintf(frame, sizeof frame, "\nD %ld\n", strtol(begin + 2, NULL, 10));
                if (write(motor, frame, (size_t)size) != size)
                    return 1;
            }
            begin = end + 1;
        }
        used -= (size_t)(begin - held);
        memmove(held, begin, used);
    }
}
