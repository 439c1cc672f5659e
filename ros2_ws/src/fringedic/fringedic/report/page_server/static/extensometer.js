// The virtual extensometer: its gauge points [column, row] stay while the views change.

import { gauge } from "./server.js";

export const extensometer = { points: [], subset: 9 };

// Strain of every step, with its standard deviation; none without both points.
export const strains = async () => (extensometer.points.length === 2 ? gauge(...extensometer.points, extensometer.subset) : []);
