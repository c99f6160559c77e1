/* Files that appear whole or not at all. See output.h. */
#include "output.h"
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

bool output_special(const char *path)
{
    struct stat s;
    return stat(path, &s) == 0 && !S_ISREG(s.st_mode) && !S_ISDIR(s.st_mode);
}

static bool is_folder(const char *path)
{
    struct stat s;
    return stat(path, &s) == 0 && S_ISDIR(s.st_mode);
}

static bool cannot_write(const char *path, int error, Report *report) { return report_error(report, path, 0, "cannot write: %s", strerror(error)); }

bool output_open(Output *o, const char *path, Report *report)
{
    *o = (Output){ NULL, NULL };
    if (is_folder(path)) return cannot_write(path, EISDIR, report);
    if (output_special(path)) o->file = fopen(path, "wb");
    else {
        size_t size = strlen(path) + 32;
        o->temporary = malloc(size);
        if (o->temporary) {
            snprintf(o->temporary, size, "%s.tmp%ld", path, (long)getpid());
            unlink(o->temporary);                      /* left by one that was killed; 'x' below then refuses a link laid in our way */
            o->file = fopen(o->temporary, "wbx");
        }
    }
    if (o->file) return true;
    cannot_write(path, errno, report);
    free(o->temporary);
    return false;
}

bool output_close(Output *o, const char *path, bool good, Report *report)
{
    good = good && fflush(o->file) == 0 && !ferror(o->file);
    int error = errno;                                 /* the first one counts */
    if (fclose(o->file) != 0 && good) {
        good = false;
        error = errno;
    }
    if (good && o->temporary && rename(o->temporary, path) != 0) {
        good = false;
        error = errno;
    }
    if (!good && o->temporary) unlink(o->temporary);
    free(o->temporary);
    return good || cannot_write(path, error, report);
}

bool output_possible(const char *path, Report *report)
{
    Output o;
    if (output_special(path)) return true;
    if (!output_open(&o, path, report)) return false;
    fclose(o.file);
    unlink(o.temporary);
    free(o.temporary);
    return true;
}
