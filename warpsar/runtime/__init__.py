"""How work is done: devices, threads, launches, memory, and several processes.

devices: Warp's start, and the device of a name. threads: tasks on all cores. launches: launches that are recorded, cut
and replayed. program: a sequence of launches and its gradients. memory: bounds, and smaller parts where memory runs
out. background: files written beside the work. console: messages and progress. matmul: products inside one thread.
distributed: the processes of one run. once: what a run does once, however many processes it has. deadline: a time by
which work shall end. forecast: how long work will take, in words. busy: a sign of life for work that cannot say how far
it is. structs: what kernels take together. plugins: what stands in a folder, a file each. extra: libraries that pip
brings.
"""
