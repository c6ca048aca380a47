"""How much memory a program took, reported by itself."""

# Lines of a program that define peak_kib(). Not getrusage: what that gives for a new program begins with the peak of the
# process that started it, which may hide all of its own.
PEAK_KIB = (
    "def peak_kib():\n"
    "    return int(next(line for line in open('/proc/self/status') if line.startswith('VmHWM')).split()[1])\n"
)
