"""Threads, processes, signals: the interpreter stays free, Ctrl-C is answered, forks and spawns work, nothing panics."""

import concurrent.futures
import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest

import isoplanat as iso

# Each takes far longer than a second.
LONG = {
    "render": "iso.render(lens, photo, iso.Frame(6000, 4000, 6.0), min_psnr_db=60)",
    "record": "iso.render.record(lens, photo, iso.Frame(3000, 2000, 12.0), min_psnr_db=60)",
    "psf": "lens.psf(fields=512, distances_mm=np.linspace(900, 5000, 8), size=301, pitch_um=2, rays=1000000)",
    "vjp": "psf.vjp(np.ones_like(psf.kernels))",
    "trace": "lens.trace(np.random.default_rng(1).uniform(-4, 4, (40_000_000, 3)) - [0, 0, 20], [0, 0, 1.0])",
    "capture": "iso.capture(lens, photo, iso.Frame(6000, 4000, 6.0), samples=4096)",
    "optimize": "lens.replace({'surface[0].thickness': 4.0}).optimize(iterations=10**9, vary=['surface[*].*'], quality='wavefront', "
    "distances_mm=list(np.linspace(500, 5000, 600)))",
    "report": "lens.report(rays=1000000)",
}


@pytest.mark.parametrize("name", LONG)
def test_an_interrupt_is_answered_within_a_second(name):
    """Ctrl-C in the middle of long work: KeyboardInterrupt within a second, and the next call works."""
    code = f"""
        import signal, sys, time
        import numpy as np, isoplanat as iso
        lens = iso.Lens("cooke_triplet")
        photo = iso.scene("mixed", 200, 300)
        if {name!r} == "vjp":
            psf = lens.psf(fields=64, size=65, pitch_um=4, rays=100000)
        def told(*_):
            global asked
            asked = time.monotonic()
            raise KeyboardInterrupt
        signal.signal(signal.SIGALRM, told)
        signal.setitimer(signal.ITIMER_REAL, 0.7)
        try:
            {LONG[name]}
        except KeyboardInterrupt:
            print(time.monotonic() - asked)
        else:
            sys.exit("it was not long")
        print(iso.render(lens, photo, iso.Frame(24, 16, 1500.0), min_psnr_db=30)[0].shape)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    seconds, shape = done.stdout.splitlines()
    # On a machine that does other work as well, twice as long.
    assert float(seconds) < 2.0 and shape == "(3, 16, 24)"


def test_the_interpreter_is_free_meanwhile():
    lens, photo = iso.Lens("cooke_triplet"), iso.scene("mixed", 200, 300)
    done = threading.Event()

    def work():
        iso.render(lens, photo, iso.Frame(600, 400, 60.0), min_psnr_db=50)
        done.set()

    thread = threading.Thread(target=work)
    thread.start()
    turns = 0
    while not done.is_set():
        turns += 1
        time.sleep(0.001)
    thread.join()
    assert turns > 20


def test_threads_take_turns_and_agree():
    lens, photo, frame = iso.Lens("cooke_triplet"), iso.scene("mixed", 60, 90), iso.Frame(48, 32, 750.0)
    one = iso.render(lens, photo, frame, min_psnr_db=35)[0]
    with concurrent.futures.ThreadPoolExecutor(6) as pool:
        for other in pool.map(lambda _: iso.render(lens, photo, frame, min_psnr_db=35)[0], range(12)):
            assert (other == one).all()


def test_processes_of_one_machine_share_its_cores():
    for told, wanted in [({"LOCAL_WORLD_SIZE": "2"}, max(1, os.cpu_count() // 2)), ({"LOCAL_WORLD_SIZE": "2", "RAYON_NUM_THREADS": "3"}, 3)]:
        environment = {k: v for k, v in os.environ.items() if k not in ("RAYON_NUM_THREADS", "LOCAL_WORLD_SIZE")}
        command = [sys.executable, "-c", "import isoplanat as iso; iso.Lens('tessar').spot(); print(iso.threads())"]
        done = subprocess.run(command, env={**environment, **told}, capture_output=True, text=True, check=True)
        assert int(done.stdout) == wanted, told


def test_results_do_not_depend_on_the_number_of_threads():
    lens, photo, frame = iso.Lens("cooke_triplet"), iso.scene("mixed", 60, 90), iso.Frame(48, 32, 750.0)
    before = iso.threads()
    results = []
    try:
        for count in [1, 2, 3]:
            iso.set_threads(count)
            assert iso.threads() == count
            value, record = iso.render.record(lens, photo, frame, min_psnr_db=35)
            results.append((value.tobytes(), record.vjp(value), lens.psf(size=21).kernels.tobytes()))
        assert results[0] == results[1] == results[2]
    finally:
        iso.set_threads(before)
    for wrong in [0, 5000]:
        with pytest.raises(ValueError, match=f"count: {wrong}; 1 to 1024 threads"):
            iso.set_threads(wrong)
    with pytest.raises(OverflowError):
        iso.set_threads(-1)


def job(lens):
    """What a worker does: a lens that came as a pickle, rays and a picture."""
    photo = iso.scene("mixed", 60, 90)
    picture, _ = iso.render(lens, photo, iso.Frame(48, 32, 750.0), min_psnr_db=35)
    return iso.threads(), float(picture.sum()), lens


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no processes are forked here")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("how", ["fork", "spawn", "forkserver"])
def test_workers_work(how):
    """After the parent's pool has worked: forked workers have one thread of their own, spawned ones as many as the machine says."""
    lens = iso.Lens("cooke_triplet")
    _, total, _ = job(lens)
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        with multiprocessing.get_context(how).Pool(2) as pool:
            for threads, found, again in pool.map_async(job, [lens] * 4).get(timeout=120):
                assert found == total and again == lens
                assert how != "fork" or threads == 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no processes are forked here")
def test_a_fork_in_the_middle_of_work_does_not_hang():
    """Another thread renders while this one forks."""
    code = """
        import os, threading, warnings
        import isoplanat as iso
        warnings.simplefilter("ignore")
        lens, photo = iso.Lens("cooke_triplet"), iso.scene("mixed", 200, 300)
        thread = threading.Thread(target=lambda: iso.render(lens, photo, iso.Frame(600, 400, 60.0), min_psnr_db=50))
        thread.start()
        for _ in range(8):
            child = os.fork()
            if child == 0:
                ok = iso.render(lens, photo, iso.Frame(24, 16, 1500.0), min_psnr_db=30)[0].shape == (3, 16, 24)
                os._exit(0 if ok and iso.threads() == 1 else 1)
            assert os.waitpid(child, 0)[1] == 0
        thread.join()
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_nothing_is_printed_and_nothing_panics():
    """Calls with arguments of every wrong kind: one exception each, of the usual kinds, and nothing on stderr."""
    code = """
        import itertools
        import numpy as np, isoplanat as iso
        lens = iso.Lens("cooke_triplet")
        psf = lens.psf(fields=2, size=9)
        photo = iso.scene("mixed", 6, 9)
        value, record = iso.render.record(lens, photo, iso.Frame(12, 8, 3000.0), min_psnr_db=20)
        odd = [None, -1, 0, 2**70, float("nan"), float("inf"), "x", b"x", (), [], {}, object(), np.zeros(0), np.zeros((0, 0, 0), np.float32),
               np.full((3, 2, 2), np.nan), np.zeros((2,) * 9), np.array(["a"]), lens, iso.Frame(1, 1, 1e-300)]
        frame = iso.Frame(4, 3, 5000.0)
        calls = [iso.Lens, lens.replace, lens.trace, lens.psf, lens.save, psf.vjp, record.vjp, iso.read_picture, iso.write_picture, iso.scene, iso.Frame,
                 lens.inspect, lens.spot, lens.mtf, iso.develop]
        renders = [iso.render, iso.render.record, iso.render.plan, iso.capture]
        usual = (ValueError, TypeError, OSError, OverflowError)
        seen = 0
        for call in calls + renders:
            if call in renders:
                tried = itertools.product(odd, [photo], [frame])
                tried = itertools.chain(tried, ((lens, a, frame) for a in odd), ((lens, photo, a) for a in odd if a is not None))
            else:
                tried = itertools.chain([(a,) for a in odd if call is not lens.psf], itertools.product(odd, odd))
            for arguments in tried:
                try:
                    call(*arguments)
                except usual as error:
                    assert "internal error" not in str(error) and "panic" not in str(error), (call, arguments, error)
                    seen += 1
        for name, value in itertools.product(["fields_deg", "distances_mm", "pitch_um", "size", "fields", "wavelengths_nm", "rays", "dtype", "like"], odd):
            try:
                lens.psf(**{name: value})
            except usual as error:
                assert "internal error" not in str(error), (name, value, error)
                seen += 1
        assert seen > 3000, seen
    """
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", textwrap.dedent(code)], capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_small_call_costs_little():
    """A ray by `trace` beside the time that the call takes of itself, with room for a busy machine; the figure is printed."""
    lens = iso.Lens("cooke_triplet")
    origin, direction = np.array([[0.0, 1.0, -10.0]]), np.array([[0.0, 0.0, 1.0]])
    lens.trace(origin, direction)
    best = min(timed(lambda: lens.trace(origin, direction)) for _ in range(2000))
    name = min(timed(lambda: lens.name) for _ in range(2000))
    print(f"trace of one ray {best * 1e6:.2f} µs, an attribute {name * 1e6:.2f} µs")
    assert best < 100e-6 and name < 5e-6


def timed(call):
    start = time.perf_counter()
    call()
    return time.perf_counter() - start
