/* Lends ptys the modem lines that they lack: where the kernel answers ENOTTY the request succeeds, and DTR is logged. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <termios.h>

int ioctl(int fd, unsigned long request, ...)
{
    static int (*real)(int, unsigned long, ...);
    static int lines;
    va_list arguments;
    va_start(arguments, request);
    int *value = va_arg(arguments, int *);
    va_end(arguments);
    if (!real)
        real = (int (*)(int, unsigned long, ...))dlsym(RTLD_NEXT, "ioctl");
    int result = real(fd, request, value);
    if (result == 0 || errno != ENOTTY)
        return result;
    if (request == TIOCMGET)
        *value = lines;
    else if (request == TIOCMBIS)
        lines |= *value;
    else if (request == TIOCMBIC)
        lines &= ~*value;
    else if (request == TIOCMSET)
        lines = *value;
    else
        return result;
    const char *path = getenv("MODEM_LOG");
    FILE *log = path && request != TIOCMGET ? fopen(path, "a") : NULL;
    if (log) {
        fprintf(log, "dtr=%d\n", (lines & TIOCM_DTR) != 0);
        fclose(log);
    }
    return 0;
}
