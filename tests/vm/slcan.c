// slcan FIFO NAME: a CAN adapter on a serial line, as far as the kernel can tell (line discipline slcan on a pseudo
// terminal). Writes the name of its interface to the file NAME, takes what the kernel sends, and hands the lines of FIFO to
// the kernel: "sb000256" is a controller that has gone off the bus after 256 errors, "sw100000" one near its warning level,
// "sp130000" one that is error passive, "t1232AABB" a frame. STALL and GO: stops taking what the kernel sends, and goes on.
#define _GNU_SOURCE
#include <fcntl.h>
#include <net/if.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

enum { LINE_DISCIPLINE_SLCAN = 17 };

int main(int count, char **words) {
  if (count != 3) return 2;
  int adapter = posix_openpt(O_RDWR | O_NOCTTY);
  char path[64];
  if (adapter < 0 || grantpt(adapter) || unlockpt(adapter) || ptsname_r(adapter, path, sizeof path)) return 1;
  int line = open(path, O_RDWR | O_NOCTTY);
  struct termios raw;
  if (line < 0 || tcgetattr(line, &raw)) return 1;
  cfmakeraw(&raw);
  tcsetattr(line, TCSANOW, &raw);
  int discipline = LINE_DISCIPLINE_SLCAN;
  char name[IFNAMSIZ] = "";
  if (ioctl(line, TIOCSETD, &discipline) || ioctl(line, SIOCGIFNAME, name)) return 1;
  FILE *named = fopen(words[2], "w");
  if (!named || fprintf(named, "%s\n", name) < 0 || fclose(named)) return 1;

  // Opened for writing too, so that it never ends.
  int orders = open(words[1], O_RDWR);
  FILE *reader = fdopen(orders, "r");
  if (!reader) return 1;
  fcntl(orders, F_SETFL, O_NONBLOCK);
  int stalled = 0;
  for (;;) {
    struct pollfd polled[2] = {{orders, POLLIN, 0}, {stalled ? -1 : adapter, POLLIN, 0}};
    poll(polled, 2, -1);
    char text[256];
    if (polled[1].revents & POLLIN && read(adapter, text, sizeof text) < 0) return 1;
    while (fgets(text, sizeof text - 1, reader)) {
      text[strcspn(text, "\n")] = '\0';
      if (!strcmp(text, "STALL")) {
        stalled = 1;
      } else if (!strcmp(text, "GO")) {
        stalled = 0;
      } else {
        strcat(text, "\r");
        if (write(adapter, text, strlen(text)) < 0) return 1;
      }
    }
    clearerr(reader);
  }
}
