"""A program's report of its own peak memory."""

# Lines of a program that define peak_kib(). Not by getrusage, whose value for a new program starts at the peak of the
# process that started it and may hide the program's own.
PEAK_KIB = (
    "def peak_kib():\n"
    "    return int(next(line for line in open('/proc/self/status') if line.startswith('VmHWM')).split()[1])\n"
)
