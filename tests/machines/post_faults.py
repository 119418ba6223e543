"""What can go wrong with the post, each at the place where physics puts it."""

from __future__ import annotations

import numpy as np
from machines.post import HEAD, MASSES, Array, Course, Heat, Post


def scaled(course: Course, gain: float, start: float = -np.inf) -> Course:
    """A heater with `gain` times its power from `start` [s] on.

    Parameters
    ----------
    course : Course
    gain : float
    start : float [s]
    """
    if start <= course.times[0]:
        return Course(course.times, gain * course.levels)
    times = np.append(course.times, start)
    levels = np.append(course.levels, course.at(start))
    order = np.argsort(times, kind="stable")
    times, levels = times[order], levels[order]
    return Course(times, np.where(times >= start, gain, 1.0) * levels)


def powered(course: Course, exponent: float) -> Course:
    """A heater whose power goes with a power of what is commanded.

    Parameters
    ----------
    course : Course
    exponent : float
    """
    return Course(course.times, course.levels**exponent)


def fan(post: Post, stronger: float, on: float, band: float) -> Heat:
    """A fan that nobody logs, switched by the head's temperature.

    Parameters
    ----------
    post : Post
    stronger : float
        Film while it runs, over the usual one.
    on, band : float [K]
        It runs from `on` above the air until `band` below that.
    """
    running = False

    def heat(time: float, temperature: Array) -> Array:
        nonlocal running
        head = temperature[HEAD]
        running = head >= on or (running and head > on - band)
        return -post.film * (stronger - 1.0) * temperature * running

    return heat


def melting(mass: int, melts: float, energy: float, step: float, post: Post) -> Heat:
    """A filling at one mass that melts at a temperature and freezes there again.

    Parameters
    ----------
    mass : int
    melts : float [K]
    energy : float [J]
        To melt all of it.
    step : float [s]
        Of the simulation.
    post : Post
    """
    taken = 0.0

    def heat(time: float, temperature: Array) -> Array:
        nonlocal taken
        # Half of what would bring the mass to the melting point within a step.
        wanted = 0.5 * post.capacity[mass] * (temperature[mass] - melts)
        given = float(np.clip(wanted, -taken, energy - taken))
        taken += given
        flows = np.zeros(MASSES)
        flows[mass] = -given / step
        return flows

    return heat


def sticking(expansion: Array, friction: float) -> Array:
    """A slide on a spring with dry friction: it moves only while the spring pulls harder.

    Parameters
    ----------
    expansion : ndarray, shape (n,)
    friction : float
        Stretch of the spring at which the slide begins to move.
    """
    slide, here = np.empty_like(expansion), 0.0
    for k, wanted in enumerate(expansion):
        pull = wanted - here
        if abs(pull) > friction:
            here += pull - np.copysign(friction, pull)
        slide[k] = here
    return slide


def slipping(expansion: Array, friction: float) -> Array:
    """A slide that lets go of all its load when it slips.

    Parameters
    ----------
    expansion : ndarray, shape (n,)
    friction : float
    """
    slide, here = np.empty_like(expansion), 0.0
    for k, wanted in enumerate(expansion):
        if abs(wanted - here) > friction:
            here = wanted
        slide[k] = here
    return slide


def self_heated(time: Array, reading: Array, rise: float, tau: float) -> Array:
    """A thermometer that its own current warms after it is switched on.

    Parameters
    ----------
    time, reading : ndarray, shape (n,)
    rise : float [K]
    tau : float [s]
    """
    return reading + rise * (1.0 - np.exp(-(time - time[0]) / tau))
