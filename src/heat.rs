//! Energies as pictures: a perceptually ordered colour map, and sheets of panels.
