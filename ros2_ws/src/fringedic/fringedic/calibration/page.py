"""Text of the calibration report, a template."""

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>Calibration of the rig: {{ word }} ({{ rig.identifier }})</title>
<style>
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: .2rem; }
h2 { font-size: 1.15rem; margin-top: 2.2rem; border-bottom: 1px solid #ddd; padding-bottom: .2rem; }
.meta, .note { color: #666; font-size: .9rem; }
.verdict { display: flex; gap: 1.2rem; align-items: center; border-radius: .6rem; padding: 1rem 1.3rem;
 margin: 1rem 0; }
.verdict.green { background: #e6f4e7; } .verdict.yellow { background: #fdf3d7; } .verdict.red { background: #fbe3e1; }
.light { flex: none; background: #333; border-radius: .6rem; padding: .35rem; }
.light i { display: block; width: 1.3rem; height: 1.3rem; border-radius: 50%; margin: .25rem; background: #555; }
.light .red { background: #e23b2e; } .light .yellow { background: #f2b705; } .light .green { background: #3aa544; }
.word { font-size: 1.4rem; font-weight: 700; }
table { border-collapse: collapse; margin: .6rem 0; font-size: .9rem; }
th, td { text-align: left; padding: .25rem .7rem .25rem 0; border-bottom: 1px solid #e4e4e4; vertical-align: top; }
th { font-weight: 600; color: #555; }
td { white-space: nowrap; }
td.note, td.wide { white-space: normal; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
tr.chosen td { font-weight: 700; } tr.bad td { background: #fbe3e1; } tr.kept td { color: #1f5fa8; }
img { max-width: 100%; }
li { margin: .25rem 0; }
</style>
</head>
<body>
<h1>Calibration of the rig</h1>
<div class="meta">{{ rig.identifier }} · made {{ created }} · {{ rig.source }} · fringe pitch
{{ '%g' % calibration.pitch }} projector px · {{ calibration.planes | length }} images of the reference plane</div>

<div class="verdict {{ colour }}">
<div class="light">
{% for each in ("red", "yellow", "green") %}
<i{% if each == colour %} class="{{ each }}"{% endif %}></i>
{% endfor %}
</div>
<div><div class="word">{{ word }}</div>{{ sentence }}</div>
</div>

{% if calibration.warnings %}
<h2>Warnings</h2>
<ul>{% for each in calibration.warnings %}<li>{{ each }}</li>{% endfor %}</ul>
{% endif %}

<h2>What to do</h2>
<ul>{% for each in advice %}<li>{{ each }}</li>{% endfor %}</ul>

<h2>The figures that decide</h2>
<table>
{% for title, value, meaning in figures %}
<tr><th>{{ title }}</th><td><b>{{ value }}</b></td><td class="note">{{ meaning }}</td></tr>
{% endfor %}
</table>
<p class="note">Heights z are measured from the reference plane towards the camera. A residual of a phase becomes a
height
by the sensitivity of the rig at that pixel.</p>

<h2>The rig as it was found</h2>
<img alt="Geometry of the rig with the measured lengths" src="data:image/png;base64,{{ pictures.geometry }}">
<p class="note">To scale, seen along the fringes. The camera stands above the origin at h0, the projector at the
distance
d beside the camera's axis and at the height hp. Thin lines through the origin are the positions of the plane.</p>

<h2>Every image</h2>
<img alt="Residual of every plane beside the predicted noise"
 src="data:image/png;base64,{{ pictures.planes }}">
<table>
<tr><th>image</th><th></th><th class="n">pixel residual<br>[fringe]</th><th class="n">predicted<br>[fringe]</th>
<th class="n">pixel<br>residual</th><th class="n">predicted</th><th class="n">chi²</th>
<th class="n">block<br>means</th><th class="n">their<br>noise</th><th class="n">measured</th>
<th class="n">ripple<br>[fringe]</th></tr>
{% for each in planes %}
<tr class="{{ 'bad' if each.role == 'bad' else 'kept' if each.role == 'kept out' else '' }}">
<td>{{ each.name }}</td><td>{{ each.role }}</td><td class="n">{{ each.residual_fringe }}</td>
<td class="n">{{ each.predicted_fringe }}</td><td class="n">{{ each.residual }}</td>
<td class="n">{{ each.predicted }}</td>
<td class="n">{{ each.chi_square }}</td><td class="n">{{ each.systematic }}</td>
<td class="n">{{ each.systematic_noise }}</td>
<td class="n">{{ each.valid }}</td><td class="n">{{ each.ripple }}</td></tr>
{% if each.problem %}<tr class="bad"><td></td><td class="wide" colspan="10">{{ each.problem }}</td></tr>{% endif %}
{% endfor %}
</table>
<p class="note">chi²: mean square of the pixels' residual over the variance that the noise predicts, 1 is noise
alone. Ripple:
part of the residual that repeats with the fringes, and how many times per fringe; unsteady light shows at 1× and
2×, a
projector whose response is not corrected at 3× and more.</p>

<h2>What is left of each image</h2>
<img alt="Maps of the residual of block means" src="data:image/png;base64,{{ pictures.residuals }}">
<p class="note">Block means of the residual as height. Without structure it is noise. A slope tells of a wrong
angle, a step
of a wrong fringe order, waves of the projector's response, a dome or saddle of a plane that is not flat or of a
lens.</p>

<h2>Which model, and why</h2>
<p>{{ calibration.why }}</p>
<table>
<tr><th>model</th><th class="n">parameters</th><th class="n">residual of block means</th><th class="n">chi² per
degree of
freedom</th><th class="n">criterion above the best</th></tr>
{% for each in candidates %}
<tr{% if each.chosen %} class="chosen"{% endif %}><td>{{ each.name }}</td><td class="n">{{ each.parameters }}</td>
<td class="n">{{ each.systematic }}</td><td class="n">{{ each.chi_square }}</td>
<td class="n">{{ each.criterion }}</td></tr>
{% endfor %}
</table>
<p class="note">The Bayesian information criterion weighs the residual against the number of parameters; the
smallest wins.</p>

<h2>Parameters</h2>
<table>
<tr><th></th><th>parameter</th><th class="n">value</th><th class="n">sigma</th><th></th></tr>
{% for each in parameters %}
<tr><td>{{ loop.index }}</td><td>{{ each.title }}</td><td class="n">{{ each.value }}</td>
<td class="n">{{ each.sigma }}</td>
<td>{{ each.unit }}</td></tr>
{% endfor %}
</table>
<p class="note">Sigmas follow from the noise of the phase alone, scaled by nothing. The pixel size,
{{ '%.4f' % (1e6 * rig.pixel_size) }} µm, comes from the pitch of the printed grid: if that is wrong by a part,
every length above is wrong by the same part.
{% if calibration.chi_square > 2 %}
More than noise is left in the residual (chi² {{ '%.3g' % calibration.chi_square }}), so the true errors are larger than
these sigmas.
{% endif %}
</p>
<img alt="Correlation of the parameters' errors" src="data:image/png;base64,{{ pictures.correlation }}">
{% if strong %}
<p>Hardly told apart (their errors compensate; heights do not suffer):</p>
<ul>{% for each in strong %}<li>{{ each }}</li>{% endfor %}</ul>
{% endif %}

<h2>Uncertainty that the calibration brings</h2>
<img alt="Standard deviation of z by the calibration" src="data:image/png;base64,{{ pictures.uncertainty }}">
<p class="note">To be added, in squares, to the noise of a pixel. It is common to neighbouring pixels and hardly
enters
displacements.</p>

<h2>Lens of the camera</h2>
<p>{{ lens }}</p>
{% if pictures.distortion %}
<img alt="Shift of the image by the lens" src="data:image/png;base64,{{ pictures.distortion }}">
{% endif %}
</body>
</html>
"""
