// Plays a run in K3D's page, in which K3DInstance and the elements of player.html exist.
// `placeAt` draws a time: it interpolates the poses, and shows the time that it draws.

const {
    times, poses, colours, span, shapes, linkBodies, linkPoints, linkSpan, link, ground, shadow, aspect,
} = K3DInstance.parameters.customData;
const floats = (bytes) => new Float32Array(bytes.slice().buffer);
const time = floats(times), pose = floats(poses), colour = colours && floats(colours), duration = time[time.length - 1];
const world = K3DInstance.getWorld(), root = world.K3DObjects;
const element = (id) => document.getElementById(id);

function copyOf(id, material) {
    const copy = world.ObjectsById[id].clone();
    copy.material = material || (colours ? copy.material.clone() : copy.material);
    copy.matrixAutoUpdate = false;
    copy.frustumCulled = false;
    root.add(copy);
    return copy;
}

let shade = null;
if (ground !== undefined) {
    // K3D draws wireframes without light; so are the ground and the shadows on it
    const flat = world.ObjectsById[ground].material;
    flat.wireframe = false;
    shade = flat.clone();
    shade.vertexColors = false;
    shade.color.setHex(shadow[0]);
}
const bodies = shapes.map((id) => copyOf(id)), shadows = shapes.map((id) => shade && copyOf(id, shade));
const links = linkBodies.map(() => copyOf(link));
[...new Set([...shapes, ...(link === undefined ? [] : [link])])].forEach((id) => {
    world.ObjectsById[id].visible = false;
});

function matrixOf(x, y, z, w, i, j, k) {
    return [
        1 - 2 * (j * j + k * k), 2 * (i * j + w * k), 2 * (i * k - w * j), 0,
        2 * (i * j - w * k), 1 - 2 * (i * i + k * k), 2 * (j * k + w * i), 0,
        2 * (i * k + w * j), 2 * (j * k - w * i), 1 - 2 * (i * i + j * j), 0,
        x, y, z, 1];
}

// The matrix m, projected along the light onto the ground.
function projected(m) {
    const [, x, , z, height] = shadow, result = m.slice();
    for (let c = 0; c < 16; c += 4) {
        result[c] = m[c] + x * m[c + 1];
        result[c + 1] = c === 12 ? height : 0;
        result[c + 2] = m[c + 2] + z * m[c + 1];
    }
    return result;
}

function pointOf(m, [x, y, z]) {
    return [0, 1, 2].map((r) => m[r] * x + m[r + 4] * y + m[r + 8] * z + m[r + 12]);
}

// The matrix of a line: it maps the y axis from 0 to 1 onto the way between two points.
function lineOf(a, b) {
    const way = [0, 1, 2].map((r) => b[r] - a[r]), length = Math.hypot(...way) || 1;
    const [x, y, z] = way.map((one) => one / length);
    // any two perpendicular directions
    const s = z < 0 ? -1 : 1, p = -1 / (s + z), q = x * y * p;
    return [1 + s * x * x * p, s * q, -s * x, 0, ...way, 0, q, s + y * y * p, -y, 0, ...a, 1];
}

function setMatrix(object, m) {
    object.matrix.fromArray(m);
    object.matrixWorldNeedsUpdate = true;
}

let now = 0, isPlaying = false, last = null;

function placeAt(seconds) {
    now = Math.min(Math.max(seconds, 0), duration);
    let k = 0, end = time.length - 1;
    while (end - k > 1) {
        const middle = (k + end) >> 1;
        if (time[middle] <= now) k = middle; else end = middle;
    }
    const share = end > k ? (now - time[k]) / (time[end] - time[k]) : 0;
    const state = share < 1 ? k : end, isIn = ([first, last]) => first <= state && state <= last;
    const matrices = bodies.map((body, b) => {
        const from = 7 * (b * time.length + k), to = from + 7 * (end - k), p = [];
        for (let c = 0; c < 7; c += 1) p.push(pose[from + c] + share * (pose[to + c] - pose[from + c]));
        const length = Math.hypot(p[3], p[4], p[5], p[6]);
        for (let c = 3; c < 7; c += 1) p[c] /= length;
        const m = matrixOf(...p), isThere = isIn(span[b]);
        setMatrix(body, m);
        if (colour) body.material.color.setHex(colour[b * time.length + state]);
        body.visible = isThere;
        if (shade) {
            setMatrix(shadows[b], projected(m));
            shadows[b].visible = isThere;
        }
        return m;
    });
    links.forEach((line, r) => {
        const [a, b] = linkBodies[r].map((one, c) => pointOf(matrices[one], linkPoints[r][c]));
        setMatrix(line, lineOf(a, b));
        line.visible = isIn(linkSpan[r]);
    });
    element('time').textContent = `${now.toFixed(2)} s of ${duration.toFixed(2)} s`;
    element('timeline').value = now;
    K3DInstance.render();
}

function play(isOn) {
    isPlaying = isOn;
    last = null;
    element('play').textContent = isOn ? '❚❚' : '▶';
    element('play').title = isOn ? 'Pause (space)' : 'Play (space)';
    if (isOn) {
        if (now >= duration) placeAt(0);
        requestAnimationFrame(tick);
    }
}

function tick(stamp) {
    if (!isPlaying) return;
    if (last !== null) placeAt(now + Number(element('speed').value) * (stamp - last) / 1000);
    last = stamp;
    if (now >= duration) play(false); else requestAnimationFrame(tick);
}

element('timeline').max = duration;
element('timeline').step = 'any';
element('timeline').addEventListener('input', (event) => {
    play(false);
    placeAt(Number(event.target.value));
});
element('play').addEventListener('click', () => play(!isPlaying));
document.addEventListener('keydown', (event) => {
    if (event.key === ' ') play(!isPlaying);
    else if (event.key === '.') { play(false); placeAt(now + duration / (time.length - 1 || 1)); }
    else if (event.key === ',') { play(false); placeAt(now - duration / (time.length - 1 || 1)); }
    else return;
    event.preventDefault();
});

// K3D sets its camera 10 ms after loading.
setTimeout(() => {
    const camera = K3DInstance.parameters.camera.slice();
    const far = Math.max(1, aspect * world.height / world.width);
    for (let c = 0; c < 3; c += 1) camera[c] = camera[c + 3] + far * (camera[c] - camera[c + 3]);
    K3DInstance.setCamera(camera);
    placeAt(0);
    play(true);
}, 50);
